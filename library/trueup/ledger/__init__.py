"""What we did: the serving pointer and the audit log."""
