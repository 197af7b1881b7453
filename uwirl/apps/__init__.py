"""Entry points."""

import logging

# A terminal that is gone or a log on a full disk loses its lines, not every line a traceback's. At import, because
# another process of a sweep is told of nothing else.
logging.raiseExceptions = False
