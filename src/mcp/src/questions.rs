//! Questions of policies that wait for a person, who answers from outside.

use std::{
    collections::BTreeMap,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use serde::Serialize;
use tokio::{sync::oneshot, time::Instant};

/// Questions that wait for an answer, by session.
#[derive(Debug, Default)]
pub struct Questions(Mutex<BTreeMap<String, Waiting>>);

#[derive(Debug)]
struct Waiting {
    text: String,
    since: Instant,
    answer: oneshot::Sender<String>,
}

/// A question that waits for an answer.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Question {
    /// Name of the session whose policy asked the question.
    pub session: String,
    /// Text of the question, as the policy asked it.
    pub question: String,
    /// For how long it has been waiting, in seconds.
    pub waiting_s: u64,
}

impl Questions {
    /// Waits for somebody to answer; none when nobody does in time.
    pub async fn ask(&self, session: &str, text: &str, patience: Duration) -> Option<String> {
        let (answer, answered) = oneshot::channel();
        let waiting = Waiting {
            text: text.to_owned(),
            since: Instant::now(),
            answer,
        };
        self.lock().insert(session.to_owned(), waiting);
        // Also when the caller stops waiting in the middle.
        let _gone = Withdraw(self, session);
        tokio::time::timeout(patience, answered).await.ok()?.ok()
    }

    /// Answers the question of a session. Whether there was one.
    pub fn answer(&self, session: &str, text: &str) -> bool {
        let waiting = self.lock().remove(session);
        waiting.is_some_and(|waiting| waiting.answer.send(text.to_owned()).is_ok())
    }

    /// Every question that waits.
    pub fn pending(&self) -> Vec<Question> {
        let question = |(session, waiting): (&String, &Waiting)| Question {
            session: session.clone(),
            question: waiting.text.clone(),
            waiting_s: waiting.since.elapsed().as_secs(),
        };
        self.lock().iter().map(question).collect()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Waiting>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Withdraw<'a>(&'a Questions, &'a str);

impl Drop for Withdraw<'_> {
    fn drop(&mut self) {
        self.0.lock().remove(self.1);
    }
}
