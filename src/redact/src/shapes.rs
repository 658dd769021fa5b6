//! Secrets that are known by their shape, for who redacts texts and for who looks through files of any kind.

/// The group of a pattern that is the secret, where not all of it is.
pub(crate) const SECRET: &str = "secret";

/// A kind of secret that is known by its shape.
#[derive(Clone, Copy, Debug)]
pub struct SecretShape {
    /// What it is, for people.
    pub kind: &'static str,
    /// The rule under which it is labelled and counted.
    pub rule: &'static str,
    /// The regular expression by which it is redacted in a text: rather one too many. Its group `secret`, if there is
    /// one, is what is redacted.
    pub in_text: &'static str,
    /// The regular expression by which it is found in any bytes, compressed ones too: so long that chance does not give
    /// it. None where what tells it is short.
    pub in_bytes: Option<&'static str>,
}

const fn token(
    kind: &'static str,
    in_text: &'static str,
    in_bytes: Option<&'static str>,
) -> SecretShape {
    SecretShape {
        kind,
        rule: "token",
        in_text,
        in_bytes,
    }
}

/// The kinds of secrets that are known by their shapes.
pub const SECRET_SHAPES: &[SecretShape] = &[
    token(
        "an API key of OpenAI, Anthropic or OpenRouter",
        r"(?-u:\b)sk-[A-Za-z0-9_-]{12,}",
        Some(r"(?-u:\b)sk-[A-Za-z0-9_-]{32,}"),
    ),
    token(
        "a Stripe key",
        r"(?-u:\b)[rs]k_(?:live|test)_[A-Za-z0-9]{12,}",
        Some(r"(?-u:\b)[rs]k_(?:live|test)_[A-Za-z0-9]{24,}"),
    ),
    token(
        "a Hugging Face token",
        r"(?-u:\b)(?:hf|api_org)_[A-Za-z0-9]{16,}",
        Some(r"(?-u:\b)(?:hf|api_org)_[A-Za-z0-9]{30,}"),
    ),
    token(
        "a GitHub token",
        r"(?-u:\b)gh[pousr]_[A-Za-z0-9]{20,}",
        Some(r"(?-u:\b)gh[pousr]_[A-Za-z0-9]{36,}"),
    ),
    token(
        "a GitHub token",
        r"(?-u:\b)github_pat_[A-Za-z0-9_]{20,}",
        Some(r"(?-u:\b)github_pat_[A-Za-z0-9_]{50,}"),
    ),
    token(
        "a GitLab token",
        r"(?-u:\b)gl[a-z]{2,6}-[A-Za-z0-9_-]{20,}",
        Some(r"(?-u:\b)glpat-[A-Za-z0-9_-]{20,}"),
    ),
    token(
        "a Slack token",
        r"(?-u:\b)xox[a-z]-[A-Za-z0-9-]{10,}",
        Some(r"(?-u:\b)xox[abeprs]-[A-Za-z0-9-]{20,}"),
    ),
    token(
        "a Google API key",
        r"(?-u:\b)AIza[A-Za-z0-9_-]{35}",
        Some(r"(?-u:\b)AIza[A-Za-z0-9_-]{35}"),
    ),
    token(
        "a Google access token",
        r"(?-u:\b)ya29\.[A-Za-z0-9_-]{20,}",
        Some(r"(?-u:\b)ya29\.[A-Za-z0-9_-]{40,}"),
    ),
    token(
        "an npm token",
        r"(?-u:\b)npm_[A-Za-z0-9]{30,}",
        Some(r"(?-u:\b)npm_[A-Za-z0-9]{36,}"),
    ),
    token(
        "a PyPI token",
        r"(?-u:\b)pypi-[A-Za-z0-9_-]{16,}",
        Some(r"(?-u:\b)pypi-AgE[A-Za-z0-9_-]{50,}"),
    ),
    token(
        "an NVIDIA API key",
        r"(?-u:\b)nvapi-[A-Za-z0-9_-]{40,}",
        Some(r"(?-u:\b)nvapi-[A-Za-z0-9_-]{40,}"),
    ),
    token(
        "a Groq API key",
        r"(?-u:\b)gsk_[A-Za-z0-9]{40,}",
        Some(r"(?-u:\b)gsk_[A-Za-z0-9]{40,}"),
    ),
    token(
        "a Replicate token",
        r"(?-u:\b)r8_[A-Za-z0-9]{37,}",
        Some(r"(?-u:\b)r8_[A-Za-z0-9]{37,}"),
    ),
    token(
        "a token of a Reel server",
        r"(?-u:\b)reel_[0-9a-f]{64}(?-u:\b)",
        Some(r"(?-u:\b)reel_[0-9a-f]{64}(?-u:\b)"),
    ),
    SecretShape {
        kind: "an AWS access key",
        rule: "aws-key",
        in_text: r"(?-u:\b)A(?:KIA|SIA|GPA|IDA|ROA|NPA)[A-Z0-9]{16}(?-u:\b)",
        in_bytes: Some(r"(?-u:\b)(?:AKIA|ASIA)[A-Z0-9]{16}(?-u:\b)"),
    },
    SecretShape {
        kind: "a signed token (JWT)",
        rule: "jwt",
        in_text: r"(?-u:\b)eyJ[A-Za-z0-9_-]{6,}\.[A-Za-z0-9_-]{6,}\.[A-Za-z0-9_-]*",
        in_bytes: Some(r"(?-u:\b)eyJ[A-Za-z0-9_-]{16,}\.eyJ[A-Za-z0-9_-]{16,}\.[A-Za-z0-9_-]{16,}"),
    },
    SecretShape {
        kind: "a bearer token",
        rule: "bearer",
        in_text: r"(?i-u:\bbearer)[ \t]+(?P<secret>[A-Za-z0-9._~+/-]{12,}=*)",
        in_bytes: None,
    },
    SecretShape {
        kind: "a private key",
        rule: "private-key",
        in_text: r"-----BEGIN [A-Z0-9 ]{0,40}PRIVATE KEY[A-Z ]{0,10}-----(?s:.*?)(?:-----END [A-Z0-9 ]{0,40}PRIVATE KEY[A-Z ]{0,10}-----|\z)",
        in_bytes: Some(r"-----BEGIN (?:[A-Z0-9]{2,12} ){0,3}PRIVATE KEY-----"),
    },
    SecretShape {
        kind: "an address with a password",
        rule: "userinfo",
        in_text: r#"[A-Za-z][A-Za-z0-9+.-]{0,30}://[^ \t\r\n/:@"'<>\\]*:(?P<secret>[^ \t\r\n/"'<>\\]+)@"#,
        in_bytes: Some(
            r"[A-Za-z0-9]{2}://[A-Za-z0-9._~%+-]{0,64}:[A-Za-z0-9._~%!$&*+=-]{1,128}@[A-Za-z0-9\[]",
        ),
    },
    SecretShape {
        kind: "an address with a token",
        rule: "userinfo",
        in_text: r#"[A-Za-z][A-Za-z0-9+.-]{0,30}://(?P<secret>[^ \t\r\n/:@"'<>\\]{16,})@"#,
        in_bytes: None,
    },
    // To the end of the line: a scheme stands before the secret, or several stand beside each other.
    SecretShape {
        kind: "the value of a header that authorizes",
        rule: "authorization",
        in_text: r#"(?i-u:\b(?:proxy-)?authorization|\b(?:set-)?cookie)["']?[ \t]*[:=][ \t]*["']?(?P<secret>[^"'\r\n\\]{4,})"#,
        in_bytes: None,
    },
];
