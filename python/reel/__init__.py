"""Record what embodied agents do, replay it bit for bit, and ask why it failed.

    import reel

    episode = reel.open("episode.mcap")       # read and verified
    episode.replay()                          # executed again, every digest compared
    episode.blame()                           # the call that decided it, and a better future
    store = reel.Store.ingest("traces", "store")
    store.sql("SELECT policy, avg(CAST(success AS INT)) FROM episodes GROUP BY policy").to_polars()

Images are NumPy arrays of 480 x 640 x 3 (uint8, RGB), depth is in millimetres, positions are in
metres in the scene's frame (z up), angles in radians.
"""

from ._arguments import ArgumentError
from ._command import command, command_json
from ._counterfactual import Comparison, Explanation, Fork
from ._display import Sankey, sankey
from ._episode import (
    Episode,
    RenderedFrame,
    Step,
    Steps,
    Verdict,
    open,
    replay,
    trace_paths,
)
from ._play import Episodes, Policy, Tasks, run, tools
from ._record import Recorder, record
from ._reel import SIM_VERSION, DivergenceError, Observation, PolicyError, ReelError, StepResult, __version__
from ._simulation import Action, Simulation
from ._store import Store, Table, export_rl, export_sft
from .polars import scan_traces

__all__ = [
    "SIM_VERSION",
    "Action",
    "ArgumentError",
    "Comparison",
    "DivergenceError",
    "Episode",
    "Episodes",
    "Explanation",
    "Fork",
    "Observation",
    "Policy",
    "PolicyError",
    "Recorder",
    "ReelError",
    "RenderedFrame",
    "Sankey",
    "Simulation",
    "Step",
    "StepResult",
    "Steps",
    "Store",
    "Table",
    "Tasks",
    "Verdict",
    "__version__",
    "command",
    "command_json",
    "export_rl",
    "export_sft",
    "open",
    "record",
    "replay",
    "run",
    "sankey",
    "scan_traces",
    "tools",
    "trace_paths",
]
