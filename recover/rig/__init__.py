"""Calibrated rigs: F(x) from photographs of a ball under fixed lights, then normals and depth of any picture at once.

In the order of use: ball (which normals a calibration picture shows), model (F(x) and its file), fit and calibrate
(F(x) from pictures of balls), markers, extrapolation (the error far from all balls), normals and poisson (a picture),
live (a loop over frames), estimate (the usual Estimate with a verdict), command (``--calibrate`` and ``--rig``).
"""
