//! Reading requests, with errors that clients can read.

use axum::{
    body::to_bytes,
    extract::{FromRequest, FromRequestParts, Path, Query, Request},
    http::request::Parts,
};
use serde::de::DeserializeOwned;

use super::ApiError;

/// Extractor of a JSON request body that refuses malformed ones with an [`ApiError`].
pub(crate) struct Body<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, _: &S) -> Result<Self, ApiError> {
        // The gate took it in already, as far as it may be large.
        let bytes = to_bytes(request.into_body(), usize::MAX).await;
        let bytes =
            bytes.map_err(|error| ApiError::bad_request("broken_body", error.to_string()))?;
        // Structs could be read from lists, too, which is not documented.
        if bytes.trim_ascii_start().starts_with(b"[") {
            return Err(ApiError::unprocessable(
                "bad_body",
                "the body does not match the schema: it is a list".to_owned(),
            ));
        }
        serde_json::from_slice(&bytes).map(Body).map_err(|error| {
            if error.is_data() {
                ApiError::unprocessable(
                    "bad_body",
                    format!("the body does not match the schema: {error}"),
                )
            } else {
                ApiError::bad_request("no_json", format!("the body is not JSON: {error}"))
            }
        })
    }
}

/// The parameters behind the question mark.
pub(crate) struct QueryParams<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for QueryParams<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let query = Query::from_request_parts(parts, state).await;
        query
            .map(|Query(value)| QueryParams(value))
            .map_err(|error| ApiError::bad_request("bad_parameter", error.body_text()))
    }
}

/// The names in the path.
pub(super) struct PathParams<T>(pub T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for PathParams<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let path = Path::from_request_parts(parts, state).await;
        path.map(|Path(value)| PathParams(value))
            .map_err(|error| ApiError::bad_request("bad_path", error.body_text()))
    }
}
