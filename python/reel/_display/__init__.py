"""What notebooks show: episodes, explanations, tables and failure flows as HTML.

Every display stands alone: no network, no library, one scoped style sheet. Texts of traces and
tables are untrusted, so all of them go through `escaped`; the script of an episode is a constant that
moves elements and parses no text.
"""

from .episodes import episode_html
from .failure_flow import Flow, Sankey, sankey
from .results import comparison_html, explanation_html, verdict_html
from .tables import table_html

__all__ = [
    "Flow", "Sankey", "comparison_html", "episode_html", "explanation_html", "sankey", "table_html", "verdict_html",
]  # fmt: skip
