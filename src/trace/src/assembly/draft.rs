//! A step whose last message has not come yet.

use reel_world::{
    Outcome, ToolCall,
    record::{
        EndRecord, GraphChanges, Lookup, PolicyOutput, RefusedReply, RewardTerm, StartRecord,
        StepInput, StepRecord, UserReply,
    },
};

use super::messages::Refusal;
use crate::{codec, schema::reel};

/// A step whose last message has not come yet.
pub(super) struct Draft {
    pub(super) offset: u64,
    pub(super) call: ToolCall,
    pub(super) policy: Option<PolicyOutput>,
    pub(super) user_reply: Option<UserReply>,
    pub(super) refused_replies: Vec<RefusedReply>,
    pub(super) lookup: Option<Lookup>,
    pub(super) result: Option<(Outcome, reel::ToolResult)>,
    pub(super) answer: Option<UserReply>,
    pub(super) changes: Option<GraphChanges>,
    pub(super) reward: Option<Vec<RewardTerm>>,
}

/// A moment that is whole but for its link, or the end.
pub(super) enum Unlinked {
    Start(Box<StartRecord>),
    Step {
        record: Box<StepRecord>,
        offset: u64,
    },
    End(Box<EndRecord>),
}

impl Draft {
    /// The inputs of the step, as far as they came.
    pub(super) fn input(&self) -> StepInput {
        StepInput {
            call: self.call.clone(),
            policy: self.policy.clone(),
            user_reply: self.user_reply.clone(),
            refused_replies: self.refused_replies.clone(),
            lookup: self.lookup.clone(),
        }
    }

    pub(super) fn into_record(
        self,
        step: u32,
        moment: codec::DigestMessage,
    ) -> Result<StepRecord, Refusal> {
        let (outcome, result) = self.result.ok_or("the result of its step is missing")?;
        Ok(StepRecord {
            step,
            input: StepInput {
                call: self.call,
                policy: self.policy,
                user_reply: self.user_reply,
                refused_replies: self.refused_replies,
                lookup: self.lookup,
            },
            outcome,
            tool: result.tool,
            reply: self.answer,
            markers: codec::read_markers(result.markers)?,
            visible: codec::read_visible(result.visible)?,
            listed: result.listed.into_iter().map(Into::into).collect(),
            object: result.object.map(Into::into),
            receptacle: result.receptacle.map(Into::into),
            held: result.held.map(Into::into),
            changes: self
                .changes
                .ok_or("the world changes of its step are missing")?,
            bodies: moment.bodies,
            robot: moment.robot,
            sim_step: moment.sim_step,
            reward: self.reward.ok_or("the reward of its step is missing")?,
            digests: moment.digests,
        })
    }
}
