"""Decoupled force/motion control: the boxes of figs. 4 and 5 and the controller of them all."""
