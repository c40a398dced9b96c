from pathlib import Path

from brdfpipe import store, surfaces


def main(input, output, params):
    """A measured relief: read, checked and levelled."""
    raw = Path(input["raw"])
    surface = surfaces.ingest(raw, params["spec"])
    store.save_dataset(
        surface,
        output["surface"],
        stage="surface",
        material=params["material"],
        inputs={"raw": raw},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs import by_hand

    by_hand(main)
