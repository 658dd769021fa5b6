//! The one step function every runner uses.
