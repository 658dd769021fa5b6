-- primitive_failure
--
-- A skill of the robot, or what is behind a proxy, failed, and nothing was done after it. The decisive step is the
-- first such failure.
--
-- Class: Other
-- Sub-class: primitive_failure
-- Priority: 24
-- Needs: goal
SELECT sequence_find(steps, '_[error_code in (''backend_error'', ''skill_failed'')] !(pick[ok] | place[ok])* $') AS found
FROM episodes
