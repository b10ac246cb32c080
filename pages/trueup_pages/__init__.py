"""What people look at: pages as templates, pictures as SVG. Values in, HTML out; no server, no
database, no clock."""
