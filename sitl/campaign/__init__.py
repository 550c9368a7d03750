"""Campaigns: many simulated flights of one scenario, on the cores of one machine or on a cluster, kept so that none is lost."""
