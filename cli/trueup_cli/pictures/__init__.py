"""Pictures: what a command leaves behind to be looked at, as SVG that stands alone."""
