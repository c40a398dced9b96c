"""Provenance of each stage: digest, inputs, parameters, software, history."""

from __future__ import annotations

import json
from typing import Any

import xarray as xr

from brdfpipe.appearance.verdicts import json_object


def entry(stage: str, dataset: xr.Dataset) -> dict[str, Any]:
    """Provenance of one stage, for the template."""
    attrs = dataset.attrs
    parameters = json_object(attrs.get("parameters"))
    return {
        "stage": stage,
        "digest": str(attrs.get("digest", "")),
        "inputs": [(name, str(value)) for name, value in json_object(attrs.get("inputs")).items()],
        "parameters": [(name, json.dumps(value, ensure_ascii=False)) for name, value in parameters.items()],
        "software": ", ".join(f"{name} {value}" for name, value in json_object(attrs.get("software")).items()),
        "history": [line for line in str(attrs.get("history", "")).splitlines() if line],
    }
