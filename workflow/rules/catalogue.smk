# All materials of a scene on one page. Materials that failed are listed with their reasons.


use rule stage_template as catalogue with:
    input:
        summaries=pipeline.of_materials("summary"),
        pages=pipeline.of_materials("report"),
    output:
        dataset="{scene}catalogue.nc",
        csv="{scene}catalogue.csv",
        page="{scene}index.html",
        lock="{scene}catalogue.lock.json",
