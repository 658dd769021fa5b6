-- repeated_call
--
-- Up to the end, calls that could bring nothing new outnumber the others, without driving around: the same looks, openings or
-- closings were made before in the same state of the world. The decisive step is the first of them.
--
-- Class: Lost Memory
-- Sub-class: repeated_call
-- Priority: 23
-- Needs: goal
SELECT prevailing_tail(steps, '[repeated and (ok or error_code = ''nothing_found'')]') AS found
FROM episodes
WHERE prevailing_tail(steps, '[repeated and (ok or error_code = ''nothing_found'')]').margin >= 3
  AND sequence_count(steps, 'nav_to[repeated and (path_length_m > path_length_m@-1 or path_length_m = 0)]') < 2
