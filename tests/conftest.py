"""What several test modules share.

``make test`` runs everything but what is marked ``slow``: long emulations, random searches of expensive functions, and sweeps over many
cases. Each of these has a representative that is not marked. ``make test-full`` (``--slow``) runs all.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import hypothesis
import pytest
from filelock import FileLock

from brdfpipe.jobs import pool

PROJECT = Path(__file__).parents[1]

EXAMPLES = 12
"""Cases of a random search in ``make test``, at most; ``make test-full`` tries as many as each test asks for."""

# No deadline: a busy machine is no failure. The same cases in every `make test`; `make test-full` searches at random.
hypothesis.settings.register_profile(
    "repeatable", deadline=None, derandomize=True, database=None, max_examples=EXAMPLES
)
hypothesis.settings.register_profile("random", deadline=None, database=None, print_blob=True)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the slow proofs too")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: a slow proof, run by `make test-full`")
    config.addinivalue_line(
        "markers", "cases(n): `make test` runs n of the test's cases, evenly spread; `make test-full` runs all"
    )
    hypothesis.settings.load_profile("random" if config.getoption("--slow") else "repeatable")
    # The server of the stages' workers starts once in this process, often for a test without real stages.
    pool.preload(pool.PRELOADED_WHERE_USED)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    # Whole builds first: begun last, they would run alone at the end. The others keep their order.
    items.sort(key=lambda item: item.path.parent != PROJECT / "tests")
    if config.getoption("--slow"):
        return
    functions: dict[tuple[Path, str], list[pytest.Item]] = {}
    for item in items:
        if "cases" in item.keywords and "slow" not in item.keywords:
            functions.setdefault((item.path, item.originalname), []).append(item)  # type: ignore[attr-defined]
    for cases in functions.values():
        (number,) = cases[0].keywords["cases"].args
        chosen = {index * len(cases) // number for index in range(number)}
        for index in set(range(len(cases))) - chosen:
            cases[index].add_marker(pytest.mark.slow)
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="a slow proof: make test-full"))
        own = getattr(getattr(item, "obj", None), "_hypothesis_internal_use_settings", None)
        if own and own.max_examples > EXAMPLES:
            item.obj._hypothesis_internal_use_settings = hypothesis.settings(own, max_examples=EXAMPLES)  # type: ignore[attr-defined]


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], None]], Path]:
    """``made_once(name, make)``: the folder that ``make`` filled, once in a run of the tests, whichever worker comes first.

    Tests read what is in it and change nothing; one that changes results works on a copy.
    """
    run = tmp_path_factory.getbasetemp()
    if run.name.startswith("popen-"):  # of one worker; those of a run are in one folder
        run = run.parent

    def folder(name: str, make: Callable[[Path], None]) -> Path:
        complete = run / name / "complete"
        with FileLock(run / f"{name}.lock"):
            if not complete.exists():
                make(run / name)
                complete.touch()
        return run / name

    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real measured data beside the checkout; tests that need it are skipped where it is absent."""
    folder = PROJECT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real measured data is not beside this checkout")
    return folder
