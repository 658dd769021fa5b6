-- stale_marker
--
-- A number that is not on the current map was used, and no call by a number succeeded after it: the agent did not find
-- back to what it had seen. The decisive step is the first use after the last call by a number that succeeded.
--
-- Class: Lost Memory
-- Sub-class: stale_marker
-- Priority: 34
SELECT sequence_find(
  steps,
  '_[error_code in (''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')] !_[ok and tool in (''pick'', ''place'', ''gaze_at'', ''open'')]* $'
) AS found
FROM episodes
