from brdfpipe.cli.main import main

main()
