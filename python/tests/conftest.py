"""Scenes of the tests, and the folder of those in the repository."""

import copy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# 20 x 10 x 5 cells: a state is about 0.2 MB.
WATER = {
    "domain": {"size": [2.0, 1.0, 0.5], "cells": [20, 10, 5]},
    "time": {"duration": 0.5},
    "liquid": {"region": [{"box": {"min": [0, 0, 0], "max": [0.5, 0.7, 0.5]}}]},
    "probe": [{"name": "front", "front": {"axis": "x"}}, {"name": "u", "velocity": {"point": [0.2, 0.2, 0.2]}}],
}

# Water around a block of rubber that is held at its upper end.
BOTH = {
    "domain": {"size": [1.0, 1.0, 0.5], "cells": [12, 12, 6]},
    "time": {"duration": 0.25},
    "liquid": {"region": [{"box": {"min": [0, 0, 0], "max": [0.4, 0.6, 0.5]}}]},
    "solid": [
        {
            "name": "beam",
            "mesh": {"box": {"size": [0.16, 0.5, 0.16], "cells": [2, 5, 2]}},
            "placement": {"translate": [0.55, 0.4, 0.25]},
            "density": 1100,
            "young": 1e5,
            "poisson": 0.3,
            "pin": [{"region": {"box": {"min": [0, 0.64, 0], "max": [1, 0.66, 0.5]}}}],
            "load": [{"region": {"box": {"min": [0, 0.1, 0], "max": [1, 0.2, 0.5]}}, "force": [5, 0, 0]}],
        }
    ],
}

# A gate that waits for a controller.
GATE = {
    "domain": {"size": [1.0, 0.5, 0.25], "cells": [16, 8, 4]},
    "time": {"duration": 0.5},
    "liquid": {"region": [{"box": {"min": [0, 0, 0], "max": [0.4, 0.3, 0.25]}}]},
    "obstacle": [{"box": {"min": [0.4, 0, 0], "max": [0.55, 0.5, 0.25]}, "keyframes": [{"t": 0}]}],
}


@pytest.fixture
def water():
    return copy.deepcopy(WATER)


@pytest.fixture
def both():
    return copy.deepcopy(BOTH)


@pytest.fixture
def gate():
    return copy.deepcopy(GATE)


@pytest.fixture
def scenes():
    return ROOT / "scenes"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """Relative paths lead to a folder of the test."""
    monkeypatch.chdir(tmp_path)
