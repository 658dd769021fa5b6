//! Contradictions in History: what an answer says was done, beside what the rows of its
//! episode tell was done.
//!
//! Why: a model that learns false memories acts on them. Sure: as sure as the validator's reading
//! of English; claims that the rows neither show nor refute raise no alarm. Rows are put together
//! by their episode and number of call (in any order), or a conversation is read from its start;
//! where a row of an episode is missing, the rows after it are not judged. Memory: some 1 kB a row
//! for at most [`ROWS_HELD_MAX`] rows; beyond, the episode that was not added to for longest is
//! judged and let go.

use std::collections::HashMap;

use reel_history::{Checker, ClaimVerdict, EpisodeFacts};

use super::{
    Check, RowFacts,
    step_facts::{StepFactsBuilder, last, setting},
};
use crate::lint::{Call, Role, RowLocation, Severity, Turn, report::Findings};

/// Rows that wait for the rest of their episode.
const ROWS_HELD_MAX: usize = 50_000;

#[derive(Default)]
pub(super) struct Histories {
    episodes: HashMap<String, Episode>,
    held: usize,
    clock: u64,
    claims: u64,
    judged: u64,
    unjudged: u64,
}

struct Episode {
    setting: EpisodeFacts,
    rows: Vec<HistoryRow>,
    touched: u64,
}

struct HistoryRow {
    place: RowLocation,
    number: u64,
    last: Option<(Call, String)>,
    history: String,
}

impl Histories {
    /// One row of an episode, if it is of the single-turn form.
    fn hold(&mut self, seen: &RowFacts, found: &mut Findings) {
        let Some(said) = seen.answers.first() else {
            return;
        };
        // also without a History a row tells of a deed
        let history = said.answer.history.clone().unwrap_or_default();
        let prompt: String = seen.example.turns[..said.turn]
            .iter()
            .filter(|turn| turn.role != Role::System)
            .map(Turn::text)
            .collect();
        let (Some(episode), Some(number), Ok(last)) = (
            seen.example.episode(),
            seen.example.call_number(),
            last(&prompt),
        ) else {
            self.unjudged += u64::from(!history.is_empty());
            return;
        };
        self.clock += 1;
        self.held += 1;
        let clock = self.clock;
        let held = self.episodes.entry(episode).or_insert_with(|| Episode {
            setting: setting(&prompt),
            rows: Vec::new(),
            touched: clock,
        });
        held.touched = clock;
        held.rows.push(HistoryRow {
            place: seen.place(),
            number,
            last,
            history,
        });
        if self.held > ROWS_HELD_MAX {
            let oldest = self
                .episodes
                .iter()
                .min_by_key(|(_, episode)| episode.touched)
                .map(|(name, _)| name.clone());
            if let Some(episode) = oldest.and_then(|name| self.episodes.remove(&name)) {
                self.judge_episode(episode, found);
            }
        }
    }

    fn judge_episode(&mut self, mut episode: Episode, found: &mut Findings) {
        self.held -= episode.rows.len();
        episode.rows.sort_by_key(|row| (row.number, row.place));
        episode.rows.dedup_by_key(|row| row.number);
        let mut checker = Checker::new(episode.setting);
        let mut teller = StepFactsBuilder::default();
        let mut before = None;
        for (index, row) in episode.rows.iter().enumerate() {
            let follows = before.map_or(row.last.is_none(), |before| row.number == before + 1);
            let deed = row
                .last
                .as_ref()
                .map(|(call, outcome)| teller.deed(call, outcome));
            if !follows || deed == Some(None) {
                self.unjudged += episode.rows[index..]
                    .iter()
                    .filter(|row| !row.history.is_empty())
                    .count() as u64;
                return;
            }
            if let Some(deed) = deed.flatten() {
                checker.push_step(deed);
            }
            before = Some(row.number);
            if !row.history.is_empty() {
                self.judge(&mut checker, &row.history, row.place, found);
            }
        }
    }

    /// A conversation: calls and their results, with a History now and then.
    fn converse(&mut self, seen: &RowFacts, found: &mut Findings) {
        let mut answers = seen.answers.iter().peekable();
        let prompt = seen
            .example
            .turns
            .iter()
            .find(|turn| turn.role == Role::User)
            .map(Turn::text)
            .unwrap_or_default();
        let mut checker = Checker::new(setting(&prompt));
        let mut teller = StepFactsBuilder::default();
        let mut waiting: Vec<Call> = Vec::new();
        for (number, turn) in seen.example.turns.iter().enumerate() {
            if let Some(said) = answers.next_if(|said| said.turn == number) {
                if !waiting.is_empty() && turn.role == Role::Assistant {
                    return;
                }
                if let Some(history) = said
                    .answer
                    .history
                    .as_ref()
                    .filter(|history| !history.is_empty())
                {
                    self.judge(&mut checker, history, seen.place(), found);
                }
                waiting.extend(said.calls.iter().rev().cloned());
            } else if turn.role == Role::ToolResult {
                let Some(deed) = waiting
                    .pop()
                    .and_then(|call| teller.deed(&call, turn.text().trim()))
                else {
                    return;
                };
                checker.push_step(deed);
            }
        }
    }

    fn judge(
        &mut self,
        checker: &mut Checker,
        history: &str,
        place: RowLocation,
        found: &mut Findings,
    ) {
        self.judged += 1;
        let claims = checker.check(history);
        self.claims += claims.len() as u64;
        for claim in claims {
            if let ClaimVerdict::Contradicted { why, step } = &claim.verdict {
                let words = || {
                    let step = step
                        .map(|step| format!(" (call {step})"))
                        .unwrap_or_default();
                    (
                        format!("{why}{step}"),
                        history
                            .get(claim.span.clone())
                            .unwrap_or_default()
                            .to_owned(),
                    )
                };
                found.add(claim.kind.as_str(), Severity::Error, &[place], words);
            }
        }
    }
}

impl Check for Histories {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "history",
            "claims of a History that the rows of its episode refute",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let turns = &seen.example.turns;
        if seen.answers.len() == 1 && !turns.iter().any(|turn| turn.role == Role::ToolResult) {
            self.hold(seen, found);
        } else {
            self.converse(seen, found);
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        let mut episodes: Vec<(String, Episode)> = self.episodes.drain().collect();
        episodes.sort_by_key(|(_, episode)| episode.rows.iter().map(|row| row.place).min());
        for (_, episode) in episodes {
            self.judge_episode(episode, found);
        }
        if self.judged == 0 {
            found.not_applicable(match self.unjudged {
                0 => "no answer has a History".to_owned(),
                rows => format!("{rows} rows with a History do not tell their episode, call, last action and outcome"),
            });
        } else {
            found.note(format!(
                "{} claims in {} rows, {} rows not judged",
                self.claims, self.judged, self.unjudged
            ));
        }
    }
}
