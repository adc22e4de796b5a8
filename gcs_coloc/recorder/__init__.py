"""Reading flights that were recorded."""
