//! The WebSocket of the contract: one message, one answer, in order. A message that is wrong is
//! answered with an error and the session goes on; a socket that closes, for whatever reason, frees
//! its session, after the call that is being executed was recorded.

use std::{sync::Arc, time::Duration};

use axum::{
    Extension,
    extract::{
        State, WebSocketUpgrade,
        ws::{CloseFrame, Message as Frame, WebSocket, close_code},
    },
    response::Response,
};
use reel_mcp::Caller;
use serde_json::{Value, json};
use tokio::time::{Instant, sleep_until, timeout};

use super::{
    environment::Environment,
    message::{Message, parse},
    random_name,
    refusal::Refusal,
    rpc,
};
use crate::{
    connections::{Client, ConnectionPlace},
    service::App,
};

/// How often a silent client is pinged, so that the system notices one that is gone.
const PING_EVERY: Duration = Duration::from_secs(30);
/// How long a client has to answer that the socket closes.
const FAREWELL: Duration = Duration::from_secs(2);

/// A client and what it takes up.
struct Visitor {
    app: Arc<App>,
    caller: Caller,
    /// Whose messages are counted: the name of its token, or its address.
    key: String,
    _place: Option<ConnectionPlace>,
}

/// What a socket brings.
enum Event {
    Text(String),
    /// A frame that is no text.
    Binary,
    /// The socket is to be closed, for this reason.
    Close(u16, &'static str),
    Gone,
}

/// Makes a request a socket, whose session lasts as long as it.
pub(super) async fn connect(
    State(app): State<Arc<App>>,
    place: Option<Extension<ConnectionPlace>>,
    caller: Option<Extension<Caller>>,
    client: Option<Extension<Client>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let limit = app.config.limits.body_mib << 20;
    let caller = caller.map(|Extension(caller)| caller).unwrap_or_default();
    let address = client.map_or_else(String::new, |client| client.0.0.ip().to_string());
    let visitor = Visitor {
        key: caller.owner.name().map_or(address, str::to_owned),
        caller,
        app,
        _place: place.map(|Extension(place)| place),
    };
    upgrade
        .max_message_size(limit)
        .max_frame_size(limit)
        .on_upgrade(move |socket| serve(socket, visitor))
}

async fn serve(mut socket: WebSocket, visitor: Visitor) {
    let Visitor { app, caller, .. } = &visitor;
    let name = format!("ws-{}", random_name());
    let mut environment = match Environment::of_connection(app.clone(), caller.clone(), name) {
        Ok(environment) => environment,
        Err(refusal) => {
            if send(&mut socket, refusal.to_message()).await {
                farewell(socket, close_code::AGAIN, "no session").await;
            }
            return;
        }
    };
    let patience = Duration::from_secs(app.config.limits.close_after_s);
    let mut idle = Instant::now() + patience;
    let (code, why) = loop {
        let answer = match next(&mut socket, &visitor, idle).await {
            Event::Text(text) if app.rates.admits(&visitor.key) => {
                match answer(&mut environment, &text).await {
                    Some(answer) => answer,
                    None => break (close_code::NORMAL, ""),
                }
            }
            Event::Text(_) => Refusal::TooFast.to_message(),
            Event::Binary => Refusal::Json("the frame is binary".to_owned()).to_message(),
            Event::Close(code, why) => break (code, why),
            Event::Gone => return,
        };
        if !send(&mut socket, answer).await {
            return;
        }
        idle = Instant::now() + patience;
    };
    // Its place is free for others before the client is told.
    drop(environment);
    farewell(socket, code, why).await;
}

/// Waits for what the socket brings next.
async fn next(socket: &mut WebSocket, visitor: &Visitor, idle: Instant) -> Event {
    let app = &visitor.app;
    let mut ping = Instant::now() + PING_EVERY;
    loop {
        let received = tokio::select! {
            () = app.closing.cancelled() => {
                return Event::Close(close_code::AWAY, "the server is shutting down");
            }
            () = visitor.caller.revoked.cancelled() => {
                return Event::Close(close_code::POLICY, "the token was revoked");
            }
            () = sleep_until(idle) => {
                return Event::Close(close_code::AWAY, "idle for too long (limits.close_after_s)");
            }
            () = sleep_until(ping) => {
                if socket.send(Frame::Ping(Vec::new().into())).await.is_err() {
                    return Event::Gone;
                }
                ping = Instant::now() + PING_EVERY;
                continue;
            }
            received = socket.recv() => received,
        };
        match received {
            Some(Ok(Frame::Text(text))) => return Event::Text(text.as_str().to_owned()),
            Some(Ok(Frame::Binary(_))) => return Event::Binary,
            // Pings are answered by the library.
            Some(Ok(Frame::Ping(_) | Frame::Pong(_))) => {}
            Some(Ok(Frame::Close(_))) | None => return Event::Gone,
            Some(Err(error)) => {
                let text = error.to_string();
                return if text.contains("too long") || text.contains("too big") {
                    Event::Close(
                        close_code::SIZE,
                        "the message is too large (limits.body_mib)",
                    )
                } else if text.contains("UTF-8") || text.contains("utf-8") {
                    Event::Close(close_code::INVALID, "the message is not UTF-8")
                } else {
                    Event::Gone
                };
            }
        }
    }
}

/// What a message is answered with; `None` if the client says that it closes.
async fn answer(environment: &mut Environment, text: &str) -> Option<Value> {
    let observed = match parse(text) {
        Ok(Message::Close) => return None,
        Ok(Message::State) => {
            let state = environment.state().await;
            state.map(|state| json!({"type": "state", "data": state}))
        }
        Ok(Message::Rpc(request)) => {
            let answer = rpc::answer(environment, request).await;
            Ok(json!({"type": "mcp", "data": answer}))
        }
        Ok(Message::Reset(body)) => environment.reset(body).await.map(observation),
        Ok(Message::Step(action)) => environment.step(action).await.map(observation),
        Err(refusal) => Err(refusal),
    };
    Some(observed.unwrap_or_else(|refusal| refusal.to_message()))
}

fn observation(data: Value) -> Value {
    json!({"type": "observation", "data": data})
}

/// Sends a message; whether the client took it.
async fn send(socket: &mut WebSocket, message: Value) -> bool {
    let sent = socket.send(Frame::Text(message.to_string().into())).await;
    sent.is_ok()
}

/// Closes the socket, and reads what the client still sends: a socket with bytes that nobody read
/// is reset, and the client would lose what was sent last.
async fn farewell(mut socket: WebSocket, code: u16, reason: &'static str) {
    let frame = CloseFrame {
        code,
        reason: reason.into(),
    };
    if socket.send(Frame::Close(Some(frame))).await.is_ok() {
        let rest = async { while let Some(Ok(_)) = socket.recv().await {} };
        let _ = timeout(FAREWELL, rest).await;
    }
}
