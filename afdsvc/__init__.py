"""afdsvc: active fault diagnosis for closed-loop machines, and why a model disagrees with its recordings.

The rooms, from thinking (pure) over knowing how (swappable) to doing (bytes, time, processes):

- `lti`: state-space algebra: coprime factors, J_K, LFT, S(theta), whitening, reduction, frequency response
- `api`: the nouns and protocols everybody agrees on
- `excite`: designing the question: bursts, efficiency, budgets
- `detect`: the statistics detectors share
- `identify`: estimating the answer: closed-loop identification
- `gap`: where simulation and recordings part: locate, name, model, improve
- `plants`: physics with named parameters and units
- `plugins`: hook specifications, manager, controllers, faults, detectors, physics
- `hal`: simulator, replay, rig drivers under one contract
- `wire`: protobuf codec and every zenoh key
- `record`: MCAP recordings, tables and model files
- `alarms`: states, history and delivery of alarms, the minute before each
- `runtime`: clock, scheduler, bursts, safety, transport
- `review`: Rerun logging and blueprint
- `report`: tables, figures, HTML
- `commission`: from one machine of the site file to its concrete parts
- `stepping`: machines of a model file that are driven, and the simulators that only step
- `service`: the only place that joins concrete parts
- `outlets`: where recordings, reviews and alarms of a site go
- `offline`: the service's pipeline over recordings
- `fault_planes`: the bursts of a recording in the complex plane, beside the curves of all faults
- `modelling`: a modeller's files in, a better model and a page out
- `explaining`: model and recordings in; why they differ, a better model and a page out
- `blind_trials`: blind trials of `explain` on disk: made, sealed, explained, opened, scored
- `batch`: many recordings through one task into one table
- `demo`: the main job on one command
- `terminal`: tables and progress bars
- `supervision`: what systemd wants to know, and log lines a machine can read
- `cli`: arguments, nothing else
- `trial`: blind trials: a truth written apart from everything it tests
- `scaffold`: new plugins as packages, and the check of what they hold
- `testing`: the conformance suites and fixtures shipped to plugin authors
- `errors`: every deliberate error
"""

__version__ = "0.1.0"
