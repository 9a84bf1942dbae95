"""The folder of a campaign: which files it holds, and what is in them.

campaign.toml                what is run: software, estimators, and the scenario with every value. Its seed
                             and the number of a trial determine all randomness of that trial.
trials/trial_000012.parquet  a trial, see `craternav_fg.campaign.trial.SCHEMA`. A trial that failed has no
                             rows, and its metadata says why.
times.jsonl                  wall times, one line per trial
summary.json                 figures of every estimator over all trials

Running a campaign again writes the same files, but for times.jsonl and the times in summary.json.
"""

import re

MARKER = "campaign.toml"
TRIALS = "trials"
TIMES = "times.jsonl"
SUMMARY = "summary.json"
# Temporary files of the workers; removed at the end.
SCRATCH = ".scratch"
# Version of the layout of this folder.
FORMAT = 1
TRIAL_NAME = re.compile(r"trial_(\d{6,})\.parquet")


def trial_name(number: int) -> str:
    """Name of the file of a trial."""
    return f"trial_{number:06d}.parquet"
