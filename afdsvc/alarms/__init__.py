"""Alarms as operators expect them: one state per fault, a history that survives restarts, and somebody who is told."""
