-- repeated_question
--
-- Up to the end the user is asked again and again what was answered already. The decisive step is the first question whose answer
-- was known.
--
-- Class: Lost Memory
-- Sub-class: repeated_question
-- Priority: 20
-- Needs: goal
SELECT prevailing_tail(steps, 'ask[repeated]') AS found
FROM episodes
WHERE prevailing_tail(steps, 'ask[repeated]').margin >= 2
   OR prevailing_tail(steps, 'ask[repeated]').margin = 1 AND sequence_match(steps, 'finish $')
