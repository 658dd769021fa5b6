-- stale_marker_slip
--
-- A number was used that is not on the current map. That alone explains nothing, and is told beside
-- what does (docs/spec.md#failure-taxonomy: a stale marker is secondary). The decisive step is its
-- first use.
--
-- Class: Lost Memory
-- Sub-class: stale_marker
-- Priority: 60
-- Needs: goal
-- Slip: yes
SELECT sequence_find(
  steps,
  '_[error_code in (''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')]'
) AS found
FROM episodes
