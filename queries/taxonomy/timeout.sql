-- timeout
--
-- The budget ended, and no other rule says on what. The decisive step is the last.
--
-- Class: Other
-- Sub-class: timeout
-- Priority: 50
-- Secondary: never
SELECT named_struct('first', CAST(length - 1 AS INT), 'last', CAST(length - 1 AS INT)) AS found
FROM episodes
WHERE end_reason = 'horizon'
