-- oscillation_slip
--
-- A receptacle was visited again in the same state of the world, on the stretch to the end. That alone explains nothing, and is
-- told beside what does, unless the measured cause is memory. The decisive step is the first such drive.
--
-- Class: Lost Memory
-- Sub-class: oscillation
-- Priority: 36
-- Needs: goal
-- Slip: yes
SELECT sequence_find(steps, 'nav_to[repeated] !(pick[ok] | place[ok] | open[ok] | close[ok])* $') AS found
FROM episodes
