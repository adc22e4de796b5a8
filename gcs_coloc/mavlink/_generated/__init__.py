"""Written by pymavlink's generator from gcs_coloc.xml; `python -m gcs_coloc.mavlink.regenerate` writes it anew."""
