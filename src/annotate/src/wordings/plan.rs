//! What is left to do, and what is done now.

use crate::voice::wordings;

wordings! {
    /// How the items of a schedule are set.
    STYLE = ["numbers", "arrows", "semicolons"];
    PLAN_OPEN = ["open {place} while my hand is free", "see that {place} is open", "open the door of {place} first", "get {place} open"];
    PLAN_FIND = ["find {object} at {place}", "look for {object} at {place}", "search {place} for {object}", "locate {object} at {place}"];
    PLAN_ASK = ["ask the user if several things fit", "ask which one is meant if it is not clear", "ask if more than one thing fits",
        "clarify with the user which one is meant if need be"];
    PLAN_PICK = ["pick up {object}", "take {object}", "grasp {object}", "pick {object} up"];
    PLAN_PUT_BACK = ["put {it} back", "return {it}", "get rid of {it}", "put {it} down again"];
    PLAN_CARRY = ["carry it to {place}", "bring it to {place}", "take it to {place}", "go with it to {place}"];
    PLAN_PLACE = ["place it there", "put it down there", "put it there", "set it down there"];
    PLAN_MORE = ["do the same for the other things", "repeat this for what else is asked for", "go on with the remaining things"];
    PLAN_CLOSE = ["close {place} again", "shut {place}", "close the door of {place}", "leave {place} closed"];
    PLAN_FINISH = ["finish", "end the episode", "finish the episode", "call finish"];

    NOW_GO = ["Go to {place}.", "Move to {place}.", "Get to {place}.", "Navigate to {place}.", "Head for {place}.", "Reach {place}."];
    NOW_WALK = ["Take stock of {place}.", "Walk around {place}.", "See what is on {place}.", "Explore {place}.",
        "List the objects on {place}.", "Check everything on {place}."];
    NOW_LOOK = ["Look for {what} here.", "Search the view for {what}.", "Find {what} in view.", "Check the view for {what}.",
        "Get {what} marked.", "See whether {what} is here."];
    NOW_MARK = ["Mark the receptacles in view.", "Get numbers for the receptacles in view.", "Number the receptacles in view.",
        "Highlight the receptacles in view.", "Find out the marker of the receptacle.", "See which receptacles are in view."];
    NOW_GAZE = ["Look closely at {it}.", "Approach {it}.", "Take a closer look at {it}.", "Get close to {it}.", "Examine {it} from nearby.",
        "Move up to {it}."];
    NOW_PICK = ["Pick up {it}.", "Take {it}.", "Grasp {it}.", "Get {it} into my hand.", "Grab {it}.", "Pick {it} up."];
    NOW_PLACE = ["Place {it} on {place}.", "Put {it} on {place}.", "Put {it} down on {place}.", "Set {it} down on {place}.",
        "Deposit {it} on {place}.", "Lay {it} on {place}."];
    NOW_OPEN = ["Open {it}.", "Open the door of {it}.", "Get the door of {it} open.", "Pull {it} open.", "Open up {it}.", "See that {it} is open."];
    NOW_CLOSE = ["Close {it}.", "Close the door of {it}.", "Shut {it}.", "Shut the door of {it}.", "Get {it} closed.", "See that {it} is shut."];
    NOW_ASK = ["Ask the user.", "Find out from the user what is meant.", "Clarify the task with the user.", "Get an answer from the user.",
        "Ask what is meant.", "Put a question to the user."];
    NOW_FINISH = ["Finish.", "End the episode.", "Finish the episode.", "Stop here.", "Conclude the episode.", "Call finish."];
    NOW_OTHER = ["Call {tool}.", "Try {tool}.", "Use {tool}.", "Make a call of {tool}.", "See what {tool} does.", "Give {tool} a try."];
}
