"""
Figures for print, drawn with matplotlib: no display, and no state that others could see.

Each figure is a function of the systems that were evaluated, and a line in ``FIGURES`` of
:mod:`vio_eval_ros.figures.catalogue`.
"""
