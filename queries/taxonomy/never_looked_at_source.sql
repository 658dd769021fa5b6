-- never_looked_at_source
--
-- Nothing was picked, and no call looked at the receptacle where the target stood before `finish`. The decisive step is `finish`:
-- where to look may have been unknown until then.
--
-- Class: Key Action Missing
-- Sub-class: never_looked
-- Priority: 34
-- Needs: goal
SELECT sequence_find(steps, 'finish $') AS found
FROM episodes
WHERE NOT sequence_match(steps, 'pick[ok]')
  AND NOT sequence_match(
    steps,
    'nav_to[ok and receptacle_match = ''src''] !nav_to[ok]* _[tool in (''show_object_by_category'', ''walk_around'') and (ok or error_code = ''nothing_found'') or tool = ''gaze_at'' and object_match is not null]'
  )
