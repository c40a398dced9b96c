from brdfpipe import report, store


def main(input, output, params):
    """The page of a material and its row of the catalogue."""
    datasets = {stage: store.open_dataset(path) for stage, path in input.items()}
    description = params["spec"]["description"]
    store.write_text(output["page"], report.material_page(datasets, description=description))
    store.save_dataset(
        report.summarise(datasets, description=description),
        output["summary"],
        stage="report",
        material=params["material"],
        inputs=datasets,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs import by_hand

    by_hand(main)
