"""
The documentation as a site: ``make docs``.

It builds without a network, and its pages can be searched from a folder as well as from a server.
"""

from vio_eval_ros.version import __version__

project = 'vio_eval_ros'
author = 'the vio_eval_ros developers'
version = release = __version__
extensions = ['myst_parser', 'sphinx_copybutton']
# tutorial.md is the first page, by way of index.rst
exclude_patterns = ['notebooks', 'tutorial.md']
myst_heading_anchors = 4
# output of programs is in blocks without a language
highlight_language = 'none'
html_theme = 'furo'
html_title = f'vio_eval_ros {__version__}'
html_show_sourcelink = False
html_copy_source = False
html_show_copyright = False
