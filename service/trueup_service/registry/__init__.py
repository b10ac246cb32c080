"""What is kept: rows in SQL, bytes in a blob store. The only place that knows a table."""
