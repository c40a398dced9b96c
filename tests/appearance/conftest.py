"""Datasets of one material."""

from __future__ import annotations

import pytest
from material_datasets import Datasets, full_material


@pytest.fixture(scope="session")
def full() -> Datasets:
    """Everything that the workflow can know of one material."""
    return full_material()
