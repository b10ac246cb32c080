"""The worker: runs jobs, one at a time in each process, and takes over those of workers that
died."""
