-- repeated_call_slip
--
-- Looks, openings or closings were made again in the same state of the world, on the stretch to the end. That alone explains
-- nothing, and is told beside what does, unless the measured cause is memory. The decisive step is the first repetition.
--
-- Class: Lost Memory
-- Sub-class: repeated_call
-- Priority: 37
-- Needs: goal
-- Slip: yes
SELECT sequence_find(steps, '_[repeated and ok and tool <> ''nav_to''] !(pick[ok] | place[ok] | open[ok] | close[ok])* $') AS found
FROM episodes
WHERE sequence_count(steps, '_[repeated and ok and tool <> ''nav_to'']') >= 2
