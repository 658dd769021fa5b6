-- oscillation
--
-- Up to the end, calls that could bring nothing new outnumber the others: the same drives, looks and openings were made
-- before in the same state of the world. Back and forth between two receptacles is the common case (paper, Lost Action
-- Memory); it does not matter how many receptacles, with which looks in between. Failures of skills do not count. The decisive step
-- is the first of these calls.
--
-- Class: Lost Memory
-- Sub-class: oscillation
-- Priority: 22
SELECT prevailing_tail(steps, '[repeated and (error_code is null or error_code not in (''skill_failed'', ''backend_error''))]') AS found
FROM episodes
WHERE prevailing_tail(steps, '[repeated and (error_code is null or error_code not in (''skill_failed'', ''backend_error''))]').margin >= 3
