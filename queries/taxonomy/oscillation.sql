-- oscillation
--
-- Up to the end, calls that could bring nothing new outnumber the others, drives among them: receptacles are visited again and again
-- in the same state of the world. Back and forth between two is the common case (paper, Lost Action Memory); it does not matter how
-- many there are, with which looks in between. A drive to where the robot stands is none, where the record says how far it drove. The decisive step is the first call that could bring nothing new.
--
-- Class: Lost Memory
-- Sub-class: oscillation
-- Priority: 22
-- Needs: goal
SELECT prevailing_tail(steps, '[repeated and (ok or error_code = ''nothing_found'')]') AS found
FROM episodes
WHERE prevailing_tail(steps, '[repeated and (ok or error_code = ''nothing_found'')]').margin >= 3
  AND sequence_count(steps, 'nav_to[repeated and (path_length_m > path_length_m@-1 or path_length_m = 0)]') >= 2
