from brdfpipe import store
from brdfpipe.masking.traced_visibility import tabulate


def main(input, output, params):
    """Visibility of the facets, traced on their map, beside Smith's."""
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    store.save_dataset(
        tabulate(**inputs), output["visibility"], stage="visibility", material=params["material"], inputs=inputs
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
