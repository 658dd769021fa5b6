-- incomplete
--
-- The task has several objects, and `finish` came when some of them stood where they belong and others were never taken. The
-- decisive step is `finish`.
--
-- Class: Key Action Missing
-- Sub-class: incomplete
-- Priority: 29
-- Needs: goal
SELECT sequence_find(steps, 'finish[goals_met >= 1 and goals_missing >= 1] $') AS found
FROM episodes
