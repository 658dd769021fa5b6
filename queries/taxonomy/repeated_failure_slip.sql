-- repeated_failure_slip
--
-- Calls that had failed were made again in the same state of the world, on the stretch to the end. That alone explains nothing,
-- and is told beside what does, unless the measured cause is memory. A full hand or a closed door tells what was left out instead.
-- The decisive step is the first repetition.
--
-- Class: Lost Memory
-- Sub-class: repeated_failure
-- Priority: 36
-- Needs: goal
-- Slip: yes
SELECT sequence_find(
  steps,
  '_[repeated and failed and error_code not in (''hand_not_free'', ''door_closed'')] !(pick[ok] | place[ok] | open[ok] | close[ok])* $'
) AS found
FROM episodes
WHERE sequence_count(steps, '_[repeated and failed]') >= 2
