"""Other people's methods on the cases of `bench.diagnosis`; they run in an environment of their own
and import nothing of trueup."""
