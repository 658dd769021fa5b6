-- repeated_failure_empty_hand
--
-- The agent tried again and again to put down what it had never taken, and had not even looked where the target stands. The
-- decisive step is the first repetition.
--
-- Class: Lost Memory
-- Sub-class: repeated_failure
-- Priority: 22
-- Needs: goal
SELECT sequence_find(steps, 'place[repeated and error_code = ''nothing_held''] .. $') AS found
FROM episodes
WHERE sequence_count(steps, 'place[repeated and error_code = ''nothing_held'']') >= 2
  AND NOT sequence_match(steps, 'pick[ok]')
  AND NOT sequence_match(
    steps,
    'nav_to[ok and receptacle_match = ''src''] !nav_to[ok]* _[tool in (''show_object_by_category'', ''walk_around'') and (ok or error_code = ''nothing_found'') or tool = ''gaze_at'' and object_match is not null]'
  )
