from brdfpipe import store
from brdfpipe.exchange import astm, companions


def main(input, output, params):
    """The table as an ASTM E1392 file, and the total reflectance beside it."""
    astm.write(store.open_dataset(input["table"], "bsdf"), output["astm"])
    companions.write_total_reflectance(store.open_dataset(input["bsdf"], "bsdf"), output["total_reflectance"])


if __name__ == "__main__":
    from brdfpipe.jobs import by_hand

    by_hand(main)
