# From a BRDF to what people ask of it: checks, appearance, table, fit, exports, report.


rule bsdf:
    input:
        predicted=branch(stages.has("predicted"), then="{material}/predicted.nc"),
        flake=branch(stages.has("multiangle"), then="{material}/flake.nc"),
        measured=branch(stages.has("rig"), then="{material}/measured.nc"),
    output:
        bsdf="{material}/bsdf.nc",
    log:
        "logs/{material}/bsdf.log",
    params:
        spec=stages.spec("bsdf"),
        code=stages.code("bsdf"),
    message:
        "bsdf of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule checks:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        checks="{material}/checks.nc",
    log:
        "logs/{material}/checks.log",
    params:
        spec=stages.spec("checks"),
        code=stages.code("checks"),
    message:
        "checks of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule appearance:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        appearance="{material}/appearance.nc",
    log:
        "logs/{material}/appearance.log",
    params:
        spec=stages.spec("appearance"),
        code=stages.code("appearance"),
    message:
        "appearance of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule preview:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        preview="{material}/preview.nc",
        png="{material}/preview.png",
    log:
        "logs/{material}/preview.log",
    params:
        spec=stages.spec("preview"),
        code=stages.code("preview"),
    message:
        "preview of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule table:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        table="{material}/table.nc",
    log:
        "logs/{material}/table.log",
    params:
        spec=stages.spec("table"),
        code=stages.code("table"),
    message:
        "table of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule lambert_gauss:
    input:
        bsdf="{material}/bsdf.nc",
    output:
        lambert_gauss="{material}/lambert_gauss.nc",
        csv="{material}/exports/{material}.lambert_gauss.csv",
    log:
        "logs/{material}/lambert_gauss.log",
    params:
        spec=stages.spec("lambert_gauss"),
        code=stages.code("lambert_gauss"),
    message:
        "lambert_gauss of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule export_astm:
    input:
        table="{material}/table.nc",
        bsdf="{material}/bsdf.nc",
    output:
        astm="{material}/exports/{material}.astm",
        total_reflectance="{material}/exports/{material}.total_reflectance.csv",
    log:
        "logs/{material}/export_astm.log",
    params:
        spec=stages.spec("export_astm"),
        code=stages.code("export_astm"),
    message:
        "export_astm of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule export_transmission:
    input:
        table="{material}/table.nc",
        bsdf="{material}/bsdf.nc",
    output:
        astm="{material}/exports/{material}.transmission.astm",
        total_transmittance="{material}/exports/{material}.total_transmittance.csv",
    log:
        "logs/{material}/export_transmission.log",
    params:
        spec=stages.spec("export_transmission"),
        code=stages.code("export_transmission"),
    message:
        "export_transmission of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)


rule report:
    input:
        surface=branch(stages.measured("surface"), then="{material}/surface.nc"),
        facets=branch(stages.has("surface"), then="{material}/facets.nc"),
        back_surface=branch(
            stages.measured("back_surface"), then="{material}/back_surface.nc"
        ),
        back_facets=branch(stages.has("back"), then="{material}/back_facets.nc"),
        interior=branch(stages.has("slab"), then="{material}/interior.nc"),
        masking=branch(stages.validates_masking, then="{material}/masking.nc"),
        index=branch(stages.has("index"), then="{material}/index.nc"),
        spectrum=branch(stages.has("spectrum"), then="{material}/spectrum.nc"),
        predicted=branch(stages.has("predicted"), then="{material}/predicted.nc"),
        multiangle=branch(stages.has("multiangle"), then="{material}/multiangle.nc"),
        flake=branch(stages.has("multiangle"), then="{material}/flake.nc"),
        reduced=branch(stages.has("rig"), then=stages.reduced("sample")),
        primary=branch(stages.has("rig"), then=stages.by_side("primary")),
        smoothed=branch(stages.has("rig"), then=stages.by_side("smoothed")),
        calibration=branch(stages.has("rig"), then=stages.calibration_of),
        comparison=branch(stages.compared, then="{material}/comparison.nc"),
        bsdf="{material}/bsdf.nc",
        checks="{material}/checks.nc",
        appearance="{material}/appearance.nc",
        preview=branch(stages.previewed, then="{material}/preview.nc"),
        table="{material}/table.nc",
        lambert_gauss="{material}/lambert_gauss.nc",
    output:
        page="{material}/report.html",
        summary="{material}/summary.nc",
    log:
        "logs/{material}/report.log",
    params:
        spec=stages.spec("report"),
        code=stages.code("report"),
    message:
        "report of {wildcards.material}"
    run:
        stages.run(rule, wildcards, input, output, params)
