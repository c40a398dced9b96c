# All materials on one page. Materials that failed are listed with their reasons.


use rule stage_template as catalogue with:
    input:
        summaries=expand("{material}/summary.nc", material=pipeline.names),
        pages=expand("{material}/report.html", material=pipeline.names),
    output:
        dataset="catalogue.nc",
        csv="catalogue.csv",
        page="index.html",
        lock="catalogue.lock.json",
