"""`python -m symsol_annot`: the command `symsol-annot`, for where that is not on the path."""

from symsol_annot_cli.main import main

if __name__ == "__main__":
    main()
