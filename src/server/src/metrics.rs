//! What Prometheus reads at `/metrics`.

use std::time::Duration;

use prometheus_client::{
    encoding::{EncodeLabelSet, text::encode},
    metrics::{
        counter::Counter,
        family::Family,
        gauge::Gauge,
        histogram::{Histogram, exponential_buckets},
    },
    registry::{Registry, Unit},
};
use reel_live::SessionEntry;

/// Everything that is counted.
pub(crate) struct Metrics {
    registry: Registry,
    requests: Family<Request, Counter>,
    request_time: Family<Route, Histogram>,
    calls: Family<Call, Counter>,
    call_time: Family<Tool, Histogram>,
    sessions: Family<State, Gauge>,
    pub connections: Gauge,
    #[cfg(feature = "tables")]
    pub jobs_running: Gauge,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
struct Request {
    method: String,
    route: String,
    status: u16,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
struct Route {
    route: String,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
struct Call {
    tool: String,
    outcome: &'static str,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
struct Tool {
    tool: String,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug, EncodeLabelSet)]
struct State {
    state: &'static str,
}

/// From one millisecond to 33 seconds.
fn times() -> Histogram {
    Histogram::new(exponential_buckets(0.001, 2.0, 16))
}

impl Metrics {
    pub fn new() -> Self {
        let mut registry = Registry::with_prefix("reel");
        let (requests, calls) = (
            Family::<Request, Counter>::default(),
            Family::<Call, Counter>::default(),
        );
        let request_time = Family::<Route, Histogram>::new_with_constructor(times);
        let call_time = Family::<Tool, Histogram>::new_with_constructor(times);
        let sessions = Family::<State, Gauge>::default();
        let connections = Gauge::default();
        registry.register("http_requests", "Requests answered", requests.clone());
        registry.register_with_unit(
            "http_request",
            "From head to head of the answer",
            Unit::Seconds,
            request_time.clone(),
        );
        registry.register(
            "tool_calls",
            "Tool calls of policies, by outcome",
            calls.clone(),
        );
        registry.register_with_unit(
            "tool_call",
            "Tool calls, waiting included",
            Unit::Seconds,
            call_time.clone(),
        );
        registry.register("sessions", "Policy sessions, by state", sessions.clone());
        registry.register("connections", "Open connections", connections.clone());
        #[cfg(feature = "tables")]
        let jobs_running = Gauge::default();
        #[cfg(feature = "tables")]
        registry.register("jobs_running", "Jobs at work", jobs_running.clone());
        Self {
            registry,
            requests,
            request_time,
            calls,
            call_time,
            sessions,
            connections,
            #[cfg(feature = "tables")]
            jobs_running,
        }
    }

    /// A request was answered. `route` is a pattern: as many as there are routes.
    pub fn request(&self, method: &str, route: &str, status: u16, took: Duration) {
        let labels = Request {
            method: method.to_owned(),
            route: route.to_owned(),
            status,
        };
        self.requests.get_or_create(&labels).inc();
        self.request_time
            .get_or_create(&Route {
                route: route.to_owned(),
            })
            .observe(took.as_secs_f64());
    }

    /// A tool call was answered. `tool` is one of ours, or `unknown`: names that clients make up
    /// are not counted apart.
    pub fn call(&self, tool: &'static str, outcome: &'static str, took: Duration) {
        self.calls
            .get_or_create(&Call {
                tool: tool.to_owned(),
                outcome,
            })
            .inc();
        self.call_time
            .get_or_create(&Tool {
                tool: tool.to_owned(),
            })
            .observe(took.as_secs_f64());
    }

    /// The text that Prometheus reads.
    pub fn text(&self, entries: &[SessionEntry]) -> String {
        for state in ["empty", "playing", "suspended", "ended", "failed"] {
            let count = entries
                .iter()
                .filter(|entry| entry.state.state == state)
                .count();
            self.sessions
                .get_or_create(&State { state })
                .set(i64::try_from(count).unwrap_or(i64::MAX));
        }
        let mut text = String::new();
        encode(&mut text, &self.registry).expect("a string takes everything");
        text
    }
}
