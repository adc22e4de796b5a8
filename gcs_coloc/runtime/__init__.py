"""The process around the service: clocks, timer, garbage collection, BLAS threads, standard streams."""
