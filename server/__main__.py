"""`python -m server` is `muslin`."""

import sys

from server.cli import main

sys.exit(main())
