from pathlib import Path

from brdfpipe import store
from brdfpipe.bsdf.registry import representation
from brdfpipe.rig.emulator import emulated_scan


def main(input, output, params):
    """A run of the emulated rig, with a material of known BSDF or with the etalon."""
    truth = representation(store.open_dataset(input["truth"], "bsdf")) if "truth" in input else None
    options = {key: value for key, value in params["spec"]["emulate"].items() if key != "truth"}
    emulated_scan.make_run(Path(input["sources"][0]), Path(output["journal"]).parent, truth, **options)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
