-- timeout
--
-- The budget ended, and no other rule says on what. The decisive step is the first
-- after the last object was moved or door opened.
--
-- Class: Other
-- Sub-class: timeout
-- Priority: 50
-- Needs: goal
-- Secondary: never
SELECT sequence_find(steps, '!_[ok and tool in (''pick'', ''place'', ''open'', ''close'')]+ $') AS found
FROM episodes
WHERE end_reason = 'horizon'
