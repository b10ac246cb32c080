"""trueup: find where a robot's dynamics model is wrong, correct it, and promote the correction only if it earns it.

    Episode -> Fit -> Candidate -> Decision -> ServingPointer -> AuditLog

Each step is a function that takes the product before it and returns the next. This package is pure: it opens no
socket, database, process or clock, and reads no environment.
"""

__version__ = "0.1.0"
