"""gcs-coloc: a ground-station service that locates MAVLink vehicles whose GPS has failed from their ranges to neighbours."""

__version__ = "0.1.0"
