"""Pages as templates and pictures as SVG: values in, HTML out. No server, no database, no clock."""
