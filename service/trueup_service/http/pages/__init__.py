"""Pages for browsers, one module for each. A page reads the registry as the routes do, and changes
it by the same actions."""
