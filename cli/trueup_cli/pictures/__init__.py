"""Pictures that commands write, as SVG files that stand alone."""
