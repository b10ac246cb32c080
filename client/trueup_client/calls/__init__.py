"""The calls of the client, one file for each noun of the service. `Client` inherits all of them."""
