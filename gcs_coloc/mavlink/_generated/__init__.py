"""Our MAVLink messages, written by pymavlink's generator from gcs_coloc.xml.

`python -m tools.regenerate_dialect` writes them anew.
"""
