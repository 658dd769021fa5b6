-- stale_marker
--
-- A number was used that is not on the current map. Secondary to anything that explains the failure; alone it decides
-- where nothing was picked or placed after it. The decisive step is its first use.
--
-- Class: Lost Memory
-- Sub-class: stale_marker
-- Priority: 40
SELECT sequence_find(
  steps,
  '_[error_code in (''unknown_marker'', ''marker_not_in_view'', ''no_marker_map'')]'
) AS found
FROM episodes
