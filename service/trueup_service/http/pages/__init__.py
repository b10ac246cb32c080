"""Pages: what a browser is shown, one module for each. A page asks the registry as the routes do,
and changes it by the same actions."""
