//! Routes with what each demands: a role, or nothing. One that is added here without saying which
//! does not compile. Beside these stand only the OpenAPI document, the answer to a method that a
//! path does not have, and the page or error for unknown paths: open to everyone. Never what a
//! route answers.

use std::sync::Arc;

use axum::{Router, middleware, routing::MethodRouter};
use utoipa::openapi::{OpenApi, path::Operation, security::SecurityRequirement};
use utoipa_axum::router::{OpenApiRouter, UtoipaMethodRouter};

use crate::{
    Role,
    gate::{self, Demand},
    service::App,
};

/// Scheme of the tokens in the OpenAPI document.
pub(crate) const TOKEN: &str = "token";

/// Routes, each behind what it demands.
pub(crate) struct Routes {
    app: Option<Arc<App>>,
    documented: OpenApiRouter<Arc<App>>,
    others: Router,
}

impl Routes {
    /// No route yet. Without a service the routes only make up the document.
    pub fn new(app: Option<&Arc<App>>, document: OpenApi) -> Self {
        Self {
            app: app.cloned(),
            documented: OpenApiRouter::with_openapi(document),
            others: Router::new(),
        }
    }

    /// A documented route that demands nothing.
    pub fn open(self, route: UtoipaMethodRouter<Arc<App>>) -> Self {
        self.documented(Demand::OPEN, route)
    }

    /// A documented route for tokens with a role.
    pub fn for_role(self, role: Role, route: UtoipaMethodRouter<Arc<App>>) -> Self {
        self.documented(Demand::role(role), route)
    }

    /// A documented route for tokens with a role, whose changes are on the audit log as an admin's
    /// are.
    pub fn audited(self, role: Role, route: UtoipaMethodRouter<Arc<App>>) -> Self {
        self.documented(Demand::role(role).audited(), route)
    }

    /// A documented route that counts its body while it reads it, for tokens with a role.
    pub fn streamed(self, role: Role, route: UtoipaMethodRouter<Arc<App>>) -> Self {
        self.documented(Demand::role(role).streamed(), route)
    }

    /// Routes of other protocols, and pages.
    pub fn other(mut self, demand: Demand, routes: Router) -> Self {
        let Some(app) = &self.app else {
            return self;
        };
        let layer = middleware::from_fn_with_state((app.clone(), demand), gate::admit);
        self.others = self.others.merge(routes.route_layer(layer));
        self
    }

    fn documented(
        mut self,
        demand: Demand,
        (schemas, mut paths, methods): UtoipaMethodRouter<Arc<App>>,
    ) -> Self {
        for operation in paths.paths.values_mut().flat_map(operations) {
            operation.security = demand
                .role
                .map(|role| vec![SecurityRequirement::new(TOKEN, [role.name()])]);
        }
        let methods: MethodRouter<Arc<App>> = match &self.app {
            Some(app) => {
                let state = (app.clone(), demand);
                methods.route_layer(middleware::from_fn_with_state(state, gate::admit))
            }
            None => methods,
        };
        self.documented = self.documented.routes((schemas, paths, methods));
        self
    }

    /// The documented routes with their document, and the others.
    pub fn split(self) -> (Router<Arc<App>>, OpenApi, Router) {
        let (router, document) = self.documented.split_for_parts();
        (router, document, self.others)
    }
}

/// The operations of a path.
pub(crate) fn operations(
    path: &mut utoipa::openapi::PathItem,
) -> impl Iterator<Item = &mut Operation> {
    [
        &mut path.get,
        &mut path.put,
        &mut path.post,
        &mut path.delete,
    ]
    .into_iter()
    .flatten()
}
