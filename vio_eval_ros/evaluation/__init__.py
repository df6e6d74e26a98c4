"""One recorded run: poses of two sources in, a result out."""
