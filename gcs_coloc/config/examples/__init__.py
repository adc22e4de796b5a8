"""Example configurations, NAME.toml each.

`default` has every setting with its default, `fleets` two fleets in one process.
"""

from pathlib import Path

EXAMPLES = Path(__file__).parent
