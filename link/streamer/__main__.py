"""``python -m link.streamer FOLDER``: the streaming process of one flight."""

import sys

from link.streamer.process import main

sys.exit(main())
