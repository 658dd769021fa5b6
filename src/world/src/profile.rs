//! How the environment behaves where the paper and the published servers differ: which tools it knows
//! and by which names, how long an episode may be.

use serde::{Deserialize, Serialize};

use crate::tool::{CallError, NameSet, Tool, ToolCall, ToolSpec};

/// How the environment behaves where the paper and the published code differ.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// Behaviour as the paper describes it; the default.
    #[default]
    Paper,
    /// The published repository's branch `main`: the server that its evaluation agents expect.
    RealRepo,
    /// The published repository's branch `gspo`: the server that its trainer expects.
    RealGspo,
}

impl Profile {
    /// All profiles, in the order in which they are listed for people.
    pub const ALL: [Profile; 3] = [Profile::Paper, Profile::RealRepo, Profile::RealGspo];

    /// Whether it is one of the published servers.
    pub fn is_published(self) -> bool {
        self != Profile::Paper
    }

    /// Most decisions in an episode. The published servers have no horizon of their own (their
    /// agents stop after 20 or 30 decisions, their trainer after 50): the number only bounds the
    /// length of a trace.
    pub fn horizon(self) -> u32 {
        if self.is_published() {
            1000
        } else {
            crate::HORIZON
        }
    }

    /// The names this profile speaks.
    pub fn names(self) -> NameSet {
        if self.is_published() {
            NameSet::RealRepo
        } else {
            NameSet::Paper
        }
    }

    /// As it stands on the command line and in traces.
    pub fn as_str(self) -> &'static str {
        match self {
            Profile::Paper => "paper",
            Profile::RealRepo => "real-repo",
            Profile::RealGspo => "real-gspo",
        }
    }

    /// Reads what [`Profile::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|profile| profile.as_str() == text)
    }

    /// The tool that a call means. The published servers know their own names only, and branch
    /// `gspo` has no `ask`.
    ///
    /// # Errors
    /// Fails if it is no tool of this profile, or its arguments are not those of the tool.
    pub fn tool(self, call: &ToolCall) -> Result<Tool, CallError> {
        let by_old_name =
            ToolSpec::by_name(&call.name).is_some_and(|spec| spec.repo_name != call.name);
        let missing = self == Profile::RealGspo && call.name == "ask";
        if self.is_published() && (by_old_name || missing) {
            return Err(CallError::UnknownTool {
                name: call.name.clone(),
            });
        }
        Tool::parse(call)
    }

    /// Whether the server takes a query for the category of that name without asking what it means:
    /// branch `main` compares names first.
    pub fn takes_literally(self, query: &str, categories: &[&str]) -> bool {
        self == Profile::RealRepo && categories.contains(&query)
    }

    /// The call as this profile's server takes it: the trainer and the agents also rename before
    /// they call. The question to the user becomes the description that branch `main` asks for.
    /// What is no tool of ours stays as it is.
    pub fn to_server_call(self, call: ToolCall) -> ToolCall {
        let Some(spec) = ToolSpec::by_name(&call.name).filter(|_| self.is_published()) else {
            return call;
        };
        let mut arguments = call.arguments;
        if let (Profile::RealRepo, "ask", Some(question)) =
            (self, spec.repo_name, arguments.get("question").cloned())
        {
            arguments =
                serde_json::json!({ "target_category": "object", "target_description": question });
        }
        ToolCall::new(spec.repo_name, arguments)
    }
}
