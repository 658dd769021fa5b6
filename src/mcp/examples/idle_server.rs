//! A server that does nothing, of the same SDK and transport as the real one: what
//! `make load` compares with.
//!
//! `idle_server [PORT]` listens on 127.0.0.1 (0: any free port) and prints where. It lists the
//! tools of profile `paper`, and answers every call at once with the same text, and with the same
//! image where the real server shows one.

use std::{
    io::{self, Write as _},
    sync::Arc,
    time::Duration,
};

use axum::Router;
use base64::Engine as _;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Profile};
use rmcp::{
    ErrorData, RoleServer, ServerHandler,
    model::{
        CallToolRequestParams, CallToolResponse, CallToolResult, ContentBlock, Implementation,
        ListToolsResult, PaginatedRequestParams, ServerCapabilities, ServerConfig,
    },
    service::RequestContext,
};
use serde_json::json;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

const SESSIONS: usize = 2_000;
const KEEP_ALIVE: Duration = Duration::from_secs(3_600);
const MAX_BODY: usize = 4 << 20;
/// Size of a typical image of the home that comes with Reel, as PNG.
const FRAME_BYTES: usize = 66_000;
/// Tools that answer in words alone.
const WORDS: [&str; 4] = ["walk_around", "ask", "list_receptacles", "list_tasks"];

#[tokio::main]
async fn main() -> io::Result<()> {
    let port = std::env::args()
        .nth(1)
        .map_or(Ok(0), |port| port.parse::<u16>());
    let Ok(port) = port else {
        eprintln!("usage: idle_server [PORT]");
        std::process::exit(2);
    };
    let frame: Arc<str> = frame().into();
    let factory = move || Idle {
        frame: frame.clone(),
    };
    let service = reel_mcp::streamable_http(
        factory,
        (SESSIONS, SESSIONS),
        KEEP_ALIVE,
        MAX_BODY,
        CancellationToken::new(),
    );
    let listener = TcpListener::bind(("127.0.0.1", port)).await?;
    println!("listening on http://{}", listener.local_addr()?);
    io::stdout().flush()?;
    axum::serve(listener, Router::new().route_service("/mcp", service)).await
}

/// Noise that does not compress, and below it one colour that does.
fn frame() -> String {
    let mut rgb = vec![0_u8; FRAME_WIDTH * FRAME_HEIGHT * 3];
    let mut state = 1_u32;
    for byte in &mut rgb[..FRAME_BYTES] {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *byte = (state >> 24) as u8;
    }
    let png = reel_trace::encode_png(&rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
    base64::engine::general_purpose::STANDARD.encode(png)
}

struct Idle {
    frame: Arc<str>,
}

impl ServerHandler for Idle {
    fn get_info(&self) -> ServerConfig {
        ServerConfig::new(ServerCapabilities::builder().enable_tools().build())
            .with_server_info(Implementation::new("reel-idle", env!("CARGO_PKG_VERSION")))
    }

    async fn list_tools(
        &self,
        _: Option<PaginatedRequestParams>,
        _: RequestContext<RoleServer>,
    ) -> Result<ListToolsResult, ErrorData> {
        Ok(ListToolsResult::with_all_items(reel_mcp::tools(
            Profile::Paper,
        )))
    }

    async fn call_tool(
        &self,
        request: CallToolRequestParams,
        _: RequestContext<RoleServer>,
    ) -> Result<CallToolResponse, ErrorData> {
        let text = "Nothing was done.";
        let mut content = vec![ContentBlock::text(text)];
        if !WORDS.contains(&&*request.name) {
            content.push(ContentBlock::image(&*self.frame, "image/png"));
        }
        let mut result = CallToolResult::success(content);
        result.structured_content = Some(json!({"ok": true, "text": text}));
        Ok(result.into())
    }
}
