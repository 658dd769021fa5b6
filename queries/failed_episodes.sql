-- failed_episodes
--
-- Every failed episode with its class (paper, Failure Mode Taxonomy) and the evidence, as the last `reel taxonomy` left them in
-- table `classes`; among them episodes that nobody judged and that a rule found.
--
-- Columns:
--   class, sub_class  the result; `not classified` and null where `reel taxonomy` has not seen the episode as it is
--   rule      the rule that decided (`reel taxonomy rules` says what it finds)
--   step, last_step  the decisive step, and the last of the evidence
--   call      the tool called at the decisive step
--   evidence  `full`, or `reduced` where no physics lies behind the trace
--   completion, length, end_reason  how far the episode came
--   policy, family, task_id, episode_id, trace  the episode
--
-- Example: reel query --store store "SELECT * FROM failed_episodes WHERE class = 'Other'"
SELECT
  coalesce(c.class, 'not classified') AS class, c.sub_class, c.rule, c.step, c.last_step,
  e.steps[c.step + 1]['tool'] AS call, c.evidence,
  e.completion, e.length, e.end_reason, e.policy, e.family, e.task_id, e.episode_id, e.trace
FROM episodes e
LEFT JOIN classes c ON c.episode_id = e.episode_id AND c.trace_digest = e.trace_digest
WHERE (NOT e.success OR (e.success IS NULL AND c.class IS NOT NULL)) AND e.parent_trace IS NULL
ORDER BY class, c.sub_class, e.policy, e.task_id, e.episode_id
