"""What can be done: each file one step, one function, one transaction, one audit entry."""
