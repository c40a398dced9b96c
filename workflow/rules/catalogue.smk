# All materials on one page. Materials that failed are listed with their reasons.


rule catalogue:
    input:
        summaries=expand("{material}/summary.nc", material=stages.names),
        pages=expand("{material}/report.html", material=stages.names),
        exports=stages.exports({"astm": "{material}/exports/{material}.astm"}),
    output:
        dataset="catalogue.nc",
        csv="catalogue.csv",
        page="index.html",
        lock="catalogue.lock.json",
    log:
        "logs/catalogue/catalogue.log",
    params:
        spec=stages.failures_spec,
        code=stages.code("catalogue"),
    message:
        "catalogue"
    run:
        stages.run(rule, wildcards, input, output, params)
