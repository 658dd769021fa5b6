"""The tools of an episode as an MCP server of verifiers, for harnesses that run elsewhere."""

# pyright: reportMissingTypeStubs=false, reportMissingTypeArgument=false, reportUnknownMemberType=false
# pyright: reportUnknownParameterType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import inspect
import io
from collections.abc import Callable
from typing import Any

import verifiers.v1 as vf

from ._calls import ToolSet
from ._play import Episode, step_episode
from ._rollouts import ENDED
from .verifiers import HouseholdData, HouseholdState, open_rollout


class HouseholdToolset(vf.Toolset[vf.ToolsetConfig, HouseholdState]):
    """The tools of one rollout: verifiers starts a server for each."""

    TOOL_PREFIX = None

    async def setup_task(self, task: HouseholdData) -> None:
        """Opens the episode of the task."""
        self._data = task
        self._episode: Episode = await asyncio.to_thread(open_rollout, task)
        self._tools = ToolSet(task.settings["profile"])
        self._lock = asyncio.Lock()
        self._exit_stack.callback(self._episode.close)

    def register(self, mcp: Any) -> None:
        """Registers the tools of the profile."""
        for index, spec in enumerate(self._tools.specs):
            mcp.add_tool(self._with_state(self._tool(index)), name=spec["name"], description=spec["description"])

    def _tool(self, index: int) -> Callable[..., Any]:
        parameters = self._tools.parameters(index)

        async def tool(**arguments: Any) -> list[Any]:
            return await self._call(self._tools.names[index], arguments)

        # the schema of the tool comes from its signature
        tool.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
        tool.__annotations__ = {each.name: each.annotation for each in parameters}
        tool.__name__ = self._tools.names[index]
        return tool

    async def _call(self, name: str, arguments: dict[str, Any]) -> list[Any]:
        async with self._lock:
            return await asyncio.to_thread(self._step, name, arguments)

    def _step(self, name: str, arguments: dict[str, Any]) -> list[Any]:
        from mcp.server.mcpserver import Image

        episode = self._episode
        if episode.ended:
            return [ENDED]
        episode.advance(step_episode(episode, self._tools, (name, arguments)))
        self.state.take(episode)
        shown: list[Any] = [f"{episode.observation.text}\n{ENDED}" if episode.ended else episode.observation.text]
        pixels = episode.image if self._data.settings["images"] else None
        if pixels is not None:
            from PIL import Image as Pixels

            buffer = io.BytesIO()
            Pixels.fromarray(pixels).save(buffer, "PNG")
            shown.append(Image(data=buffer.getvalue(), format="png"))
        return shown


if __name__ == "__main__":
    HouseholdToolset.run()

__all__ = ["HouseholdToolset"]
