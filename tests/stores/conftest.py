"""What tests of a storage share."""

import pytest


@pytest.fixture
def parts(storage):
    """The parts of a service over a storage of each kind."""
    built = storage.build()
    yield built
    built.close()
