"""afdsvc: active fault diagnosis for closed-loop machines, and why a model disagrees with its recordings.

The rooms, from mathematics to the command line; each imports only from those above it:

- `errors`: every deliberate error
- `lti`: state-space algebra: coprime factors, YJBK, LFT, whitening, reduction, frequency response
- `api`: the nouns and protocols every room speaks
- `dataset`: recordings as arrays: experiments, periods, screening, glitches, columns
- `stats`: whiteness, periodic parts, tones, coloured noise, fit measures, Levenberg-Marquardt
- `plants`: physics with named parameters and units; rotors; simulators that only step
- `detect`: features, statistics and thresholds of the detectors
- `excite`: design of bursts within limits
- `identify`: closed-loop identification
- `explain`: why simulation and recordings differ
- `plugins`: hook specifications, manager, controllers, faults, detectors, physics
- `wire`: protobuf codec and every zenoh key
- `files`: recordings, tables, model files and the site file
- `diagnosis`: from blocks to evidence and alarms, live and offline alike
- `transport`: zenoh sessions, outgoing queues, access rules, certificates
- `hal`: the rig's side: agent, control loop, simulator, replay, hardware
- `service`: the background service of a site: hub, bursts, notifications, sinks
- `present`: terminal, HTML pages, Rerun
- `trial`: blind trials of `explain`: a truth written apart from everything it tests
- `app`: the use cases, one file per command
- `testing`: conformance suites and fixtures for plugin authors
- `scaffold`: new plugins as packages, and the check of what they hold
- `cli`: arguments, nothing else
"""

import os

# One thread for linear algebra: the matrices are small, processes run side by side. Read by numpy once, when it is imported.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

__version__ = "0.1.0"
