"""python -m phfmu: the command line."""

from phfmu.cli import main

raise SystemExit(main())
