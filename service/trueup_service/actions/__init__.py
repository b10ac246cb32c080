"""What can be done to the registry. A step is one function in one transaction, with one entry of
the log; promotion, ingestion and idempotency run steps in a transaction of their own."""
