from brdfpipe import store
from brdfpipe.masking import ray_casting


def main(input, output, params):
    """Masking by rays cast over the heights, beside Smith's."""
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    store.save_dataset(
        ray_casting.compare(**inputs), output["masking"], stage="masking", material=params["material"], inputs=inputs
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
