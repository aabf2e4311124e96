"""`python -m sal_height` is the command line `sal-height`."""

from sal_height.commands import main

raise SystemExit(main())
