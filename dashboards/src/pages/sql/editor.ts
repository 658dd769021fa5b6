/** CodeMirror with SQL, in a file of its own so that the page does not wait for it. */
import { type CompletionContext, acceptCompletion, autocompletion, completionStatus, insertCompletionText, startCompletion } from "@codemirror/autocomplete";
import { defaultKeymap, history, historyKeymap } from "@codemirror/commands";
import { HighlightStyle, bracketMatching, syntaxHighlighting } from "@codemirror/language";
import { SQLDialect, sql } from "@codemirror/lang-sql";
import { type Diagnostic, lintKeymap, setDiagnostics } from "@codemirror/lint";
import { EditorState, Prec } from "@codemirror/state";
import { EditorView, drawSelection, keymap, lineNumbers, placeholder } from "@codemirror/view";
import { tags } from "@lezer/highlight";
import { type Schema, candidates } from "./schema";

export interface EditorOptions {
  parent: HTMLElement;
  text: string;
  placeholder: string;
  /** The id of the element that explains the keys. */
  describedBy: string;
  /** The names that can be completed; undefined until they are loaded. */
  schema: () => Schema | undefined;
  onChange: (text: string) => void;
  onRun: () => void;
}

export interface EditorError {
  offset: number;
  length: number;
  message: string;
}

export interface Editor {
  setText(text: string): void;
  /** Replaces the selection and takes the focus. */
  insert(text: string): void;
  select(offset: number, length: number): void;
  setError(error: EditorError | null): void;
  focus(): void;
  destroy(): void;
}

// The colours are variables of the style sheet, so that a change of the theme needs no new editor.
const colors = HighlightStyle.define([
  { tag: [tags.keyword, tags.operatorKeyword], color: "var(--accent)", fontWeight: "600" },
  { tag: tags.string, color: "var(--good)" },
  { tag: [tags.number, tags.bool, tags.null], color: "var(--warn)" },
  { tag: tags.special(tags.name), color: "var(--warn)", fontWeight: "600" },
  { tag: tags.comment, color: "var(--soft)", fontStyle: "italic" },
]);

/** A `$name` is a parameter of the question. */
const dialect = SQLDialect.define({ specialVar: "$" });

const WORD = /[A-Za-z_]\w*/;

function wordBefore(state: EditorState): { from: number; text: string } | null {
  const { head, empty } = state.selection.main;
  const line = state.doc.lineAt(head);
  const text = /[A-Za-z_]\w*$/.exec(line.text.slice(0, head - line.from))?.[0];
  return empty && text ? { from: head - text.length, text } : null;
}

export function createEditor({ parent, text, schema, onChange, onRun, ...options }: EditorOptions): Editor {
  const found = (state: EditorState, prefix: string) => {
    const names = schema();
    return names ? candidates(names, state.doc.toString(), prefix) : [];
  };
  function complete(context: CompletionContext) {
    const word = context.matchBefore(WORD);
    if (!word) return null;
    return { from: word.from, filter: false, options: found(context.state, word.text).map(({ text, kind }) => ({ label: text, detail: kind })) };
  }
  /** Completes the word before the cursor. Without one, Tab moves the focus as everywhere on a page. */
  function tab(view: EditorView): boolean {
    if (completionStatus(view.state)) return acceptCompletion(view) || true;
    const word = wordBefore(view.state);
    const names = word ? found(view.state, word.text) : [];
    if (!word || !names.length) return false;
    if (names.length > 1) return startCompletion(view);
    view.dispatch(insertCompletionText(view.state, names[0]!.text, word.from, view.state.selection.main.head));
    return true;
  }
  const run = () => {
    onRun();
    return true;
  };
  const view = new EditorView({
    parent,
    doc: text,
    extensions: [
      Prec.highest(keymap.of([{ key: "Mod-Enter", run }, { key: "Ctrl-Enter", run }, { key: "Tab", run: tab }])),
      keymap.of([...defaultKeymap, ...historyKeymap, ...lintKeymap]),
      history(),
      lineNumbers(),
      drawSelection(),
      bracketMatching(),
      EditorView.lineWrapping,
      sql({ dialect }),
      syntaxHighlighting(colors),
      autocompletion({ override: [complete], activateOnTyping: false, icons: false, interactionDelay: 0 }),
      placeholder(options.placeholder),
      EditorView.contentAttributes.of({ "aria-label": "SQL", "aria-describedby": options.describedBy }),
      EditorView.updateListener.of((update) => {
        if (update.docChanged) onChange(update.state.doc.toString());
      }),
    ],
  });
  return {
    setText(text) {
      if (text !== view.state.doc.toString()) view.dispatch({ changes: { from: 0, to: view.state.doc.length, insert: text } });
    },
    insert(text) {
      view.dispatch(view.state.replaceSelection(text), { userEvent: "input", scrollIntoView: true });
      view.focus();
    },
    select(offset, length) {
      view.dispatch({ selection: { anchor: offset, head: offset + length }, scrollIntoView: true });
      view.focus();
    },
    setError(error) {
      const end = view.state.doc.length;
      const marked: Diagnostic[] = error
        ? [{ from: Math.min(error.offset, end), to: Math.min(error.offset + error.length, end), severity: "error", message: error.message }]
        : [];
      view.dispatch(setDiagnostics(view.state, marked));
    },
    focus: () => view.focus(),
    destroy: () => view.destroy(),
  };
}
