"""One module a verb: arguments in, output and exit status out."""

import os

# OpenBLAS starts a thread for every core when numpy is imported. Nothing here is large enough to
# use them, and starting them can take longer than a whole evaluation.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
