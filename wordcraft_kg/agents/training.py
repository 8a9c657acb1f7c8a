"""Training an agent into a run folder: metrics, learning curves, checkpoints, and going on after anything but a fire.

The folder is there from the start, and ``run.json`` says how it stands: running, interrupted, failed or done. A
checkpoint holds all that the trainer knows, so on a CPU a resumed run ends with the same bits as an undisturbed one.
"""

import hashlib
import json
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import safetensors.torch
import torch

from wordcraft_kg.agents.config import ImpalaConfig, TaskConfig
from wordcraft_kg.agents.evaluation import ENDINGS, Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.impala import Impala
from wordcraft_kg.artefacts import (
    check_output,
    dump_json,
    read_json,
    with_a_name,
    write_atomically,
)
from wordcraft_kg.envs.batch import BatchEngine
from wordcraft_kg.errors import ArtefactError, ConfigError, MissingExtraError, OutputExistsError
from wordcraft_kg.graphs.folder import OpenedGraph, open_graph
from wordcraft_kg.graphs.splits import PARTS
from wordcraft_kg.models.model_folder import check_inputs, open_model
from wordcraft_kg.models.policies import Policy
from wordcraft_kg.models.policy_config import PolicyConfig
from wordcraft_kg.models.policy_folder import make_policy, read_policy, write_constants, write_parameters
from wordcraft_kg.models.scorers import read_tensors
from wordcraft_kg.runs import (
    check_device,
    end_run,
    first_interrupt,
    read_run,
    resume_run,
    start_run,
    toml_value,
    verified_bytes,
)
