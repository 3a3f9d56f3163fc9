"""Closed-loop identification.

`identify` is the one entry; below it one file per method: `subspace` (MOESP, N4SID, CVA), `pbsid`, `hansen` (original
and modified), `greybox` (prediction error, physical parameters), `indirect` (through S(theta)); and what they share:
`fit` (the one result type), `order`, `excitation`, `screening`, `reduction`, `validation`, `residual_tests`,
`jackknife`.
"""

from afdsvc.identify.fit import Fit, ParameterEstimate, ResponseBand
from afdsvc.identify.options import IdentifyOptions
from afdsvc.identify.pipeline import identify
from afdsvc.identify.result import IdentifyResult

__all__ = ["Fit", "IdentifyOptions", "IdentifyResult", "ParameterEstimate", "ResponseBand", "identify"]
