"""Test statistics: matched filter, fault curves, regression, CUSUM."""
