-- unexplained
--
-- A failure that no other rule explains. The decisive step is the last.
--
-- Class: Other
-- Sub-class: unexplained
-- Priority: 90
-- Secondary: never
SELECT named_struct('first', CAST(length - 1 AS INT), 'last', CAST(length - 1 AS INT)) AS found
FROM episodes
WHERE NOT success
