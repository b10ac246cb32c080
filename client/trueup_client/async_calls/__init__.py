"""The calls of `AsyncClient`, one file for each noun of the service.

Made by tools/make_async_client.py from trueup_client.calls.
"""
