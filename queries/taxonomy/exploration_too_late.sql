-- exploration_too_late
--
-- Ten decisions or more in a row were spent on driving around and looking; the work that followed came too late for the decisions
-- that were left. The decisive step is the first call of that stretch.
--
-- Class: Lost Memory
-- Sub-class: exploration
-- Priority: 47
-- Needs: goal
SELECT sequence_find(steps, '(nav_to | show_object_by_category | walk_around | show_receptacles){10,}') AS found
FROM episodes
WHERE end_reason = 'horizon'
