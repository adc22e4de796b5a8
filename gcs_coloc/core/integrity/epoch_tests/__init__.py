"""Tests of single epochs: do reported positions and ranges agree, and if not, which fault is it?"""
