//! A small regular language over the steps of an episode, matched in time linear in
//! the number of steps.
//!
//! Owns the language, its typed conditions, the automaton and the oscillation rule. Knows no table,
//! no Arrow and no I/O: a columnar engine evaluates [`Pattern::conditions`] over whole columns and
//! hands a [`Matcher`] one `u64` a step, whose bit `i` says whether the step fits condition `i`.
//!
//! # The language
//!
//! | written | meaning |
//! |---|---|
//! | `pick` | one step with this tool (the paper's names) |
//! | `"write_file"` | one step with this tool of another agent: in quotes any name is one |
//! | `_` or `any` | one step, whatever it is |
//! | `pick[ok]`, `_[reward < 0]`, `[reward < 0]` | one step that also fulfils the conditions in the bracket |
//! | `!ask`, `!pick[failed]`, <code>!(ask&#124;pick)</code> | one step that does *not* fit what follows, bracket included |
//! | `a b`, `a > b` | `a`, directly then `b` |
//! | `a .. b` (or `...`) | `a`, later `b`: short for `a _* b` |
//! | <code>a &#124; b</code> | either; binds weaker than "then" |
//! | `( )` | grouping |
//! | `a*  a+  a?  a{2}  a{2,}  a{2,5}` | repetition, at most [`MAX_REPEAT`] |
//! | `^`, `$` | the begin, the end of the episode |
//!
//! Tools: `nav_to walk_around show_object_by_category show_receptacles gaze_at pick place open
//! close ask finish`, and `list_receptacles list_tasks finish_with_id`. Without quotes another name is an
//! error, which says what was probably meant.
//!
//! ## Conditions
//!
//! Inside a bracket stands what SQL writes in a WHERE, over the columns of a step: `error_code =
//! 'door_closed'`, `tool in ('open', 'close')`, `argument like '%table%'`, `held is null`,
//! `goal_object`, `not goal_receptacle`, `reward < 0 and (candidate_count >= 2 or visible_count =
//! 0)`, `goal_object is not true`. `ok` is `error_code is null`, `failed` is `error_code is not
//! null`, `error` is the column `error_code`. Text stands in single or double quotes; double ones
//! need no doubling inside an SQL string. `column@-n` is the column `n` steps earlier (at most
//! [`MAX_LOOKBACK`]) in the same episode, null before its begin: `argument = argument@-2`.
//!
//! A step fits where the condition is *true*. As in SQL, a comparison with null is null, `not`
//! of null is null, and null is not true: `place[not goal_receptacle]` needs a known
//! receptacle. `!` is the exact complement instead: `!pick[goal_object]` also fits a pick of
//! which nothing is known.
//!
//! ## What a match is
//!
//! [`Matcher::find`] gives the leftmost match and, among those that begin there, the longest; it
//! may be empty (`ask*` matches nothing at step 0 of any episode). It gives one exactly if
//! [`Matcher::is_match`] is true. [`Matcher::count`] counts non-overlapping matches from left to
//! right, each the leftmost and longest of what is left, and counts no empty ones. There are no
//! lazy quantifiers, captures or backreferences.
//!
//! ```
//! use reel_query::pattern::{Pattern, StepRow, Value};
//!
//! struct Step { tool: &'static str, argument: &'static str }
//!
//! impl StepRow for Step {
//!     fn value(&self, column: &str) -> Value<'_> {
//!         match column {
//!             "tool" => Value::Text(self.tool),
//!             "argument" => Value::Text(self.argument),
//!             _ => Value::Null,
//!         }
//!     }
//! }
//!
//! let episode: Vec<Step> = ["nav_to table", "nav_to bed", "nav_to table", "nav_to bed", "pick 3"]
//!     .iter()
//!     .map(|call| call.split_once(' ').unwrap())
//!     .map(|(tool, argument)| Step { tool, argument })
//!     .collect();
//!
//! // A-B-A-B...: back and forth between two receptacles, with nothing in between
//! let pattern = Pattern::parse("nav_to nav_to[argument <> argument@-1] nav_to[argument = argument@-2]{2,}")?;
//! assert_eq!(pattern.matcher().find(&pattern.masks(&episode)), Some(0..4));
//!
//! // a pick before which nobody was asked
//! let pattern = Pattern::parse("^ !ask* pick")?;
//! assert!(pattern.matcher().is_match(&pattern.masks(&episode)));
//!
//! // the paper's canonical pipeline
//! let canonical = "nav_to show_object_by_category gaze_at? pick nav_to show_receptacles? place";
//! let pattern = Pattern::parse(canonical)?;
//! assert_eq!(pattern.matcher().count(&pattern.masks(&episode)), 0);
//! # Ok::<(), reel_query::pattern::PatternError>(())
//! ```
//!
//! # Why nothing explodes
//!
//! A pattern becomes an automaton of at most [`MAX_POSITIONS`] positions when it is parsed. A
//! [`Matcher`] makes it deterministic as far as the data ask for it, in a cache of bounded size:
//! usually one table look-up a step, at worst one pass over the positions. `is_match` reads each
//! step once; `find` and `count` read it at most three times, also for overlapping candidates,
//! because a pass from the end first tells where a match can still be completed.

mod automaton;
mod compiled;
mod condition;
mod error;
mod lexer;
mod matcher;
mod oscillation;
mod parser;
mod tools;

pub use compiled::{ColumnKind, Pattern};
pub use condition::{Condition, Literal, Op, Operand, StepColumn, StepRow, Value};
pub use error::{PatternError, SourceLocation};
pub use matcher::Matcher;
pub use oscillation::{Oscillation, oscillation};

/// Longest pattern, in bytes.
pub const MAX_LENGTH: usize = 4096;
/// Deepest nesting of parentheses, in the pattern and inside a condition.
pub const MAX_NESTING: usize = 32;
/// Largest count in a repetition such as `pick{2,100}`.
pub const MAX_REPEAT: u32 = 100;
/// Most different conditions in a pattern: a step's truth vector is one `u64`.
pub const MAX_CONDITIONS: usize = 64;
/// Most steps and anchors in a pattern once its repetitions are written out.
pub const MAX_POSITIONS: usize = 512;
/// Farthest step back that a condition may look.
pub const MAX_LOOKBACK: u32 = 32;
