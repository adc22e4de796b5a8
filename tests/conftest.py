"""Being here lets the tests import `recordings` from this folder."""
