-- physical_failure
--
-- The target fell to the floor and was not taken up again, or the physics broke down. The decisive step is the one with
-- which it fell.
--
-- Class: Other
-- Sub-class: physical_failure
-- Priority: 18
-- Needs: goal
SELECT sequence_find(steps, '_[fell = ''target'' or error_code = ''physics_fault''] !pick[ok and goal_object]* $') AS found
FROM episodes
