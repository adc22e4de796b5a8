"""Hot standby: which of two services sends, without IO. Times are service time in s, passed in."""
