//! What was done and learned, one sentence a deed, in the first person and the past tense.

use crate::voice::wordings;

wordings! {
    /// Before the first decision.
    NOTHING_YET = [
        "I have not done anything yet.",
        "Nothing has been done yet.",
        "So far nothing has been done.",
        "So far I have done nothing.",
        "I have done nothing so far.",
        "I have yet to begin.",
    ];
    WENT = [
        "I went to {place}.",
        "I moved to {place}.",
        "I navigated to {place}.",
        "I drove to {place}.",
        "I walked over to {place}.",
        "I travelled to {place}.",
    ];
    WENT_BACK = [
        "I went back to {place}.",
        "I returned to {place}.",
        "I moved to {place} again.",
        "I went to {place} once more.",
        "I navigated back to {place}.",
        "I drove back to {place}.",
    ];
    LOOKED = [
        "I looked for {what}{at} and saw {count}: {list}.",
        "I searched for {what}{at} and found {count}: {list}.",
        "I looked for {what}{at} and found {count}: {list}.",
        "Looking for {what}{at}, I saw {count}: {list}.",
        "I searched the view for {what}{at} and saw {count}: {list}.",
        "I checked the view for {what}{at} and saw {count}: {list}.",
    ];
    ALSO_SAW = [
        "I also saw {list} there.",
        "In the same view I saw {list}.",
        "Next to that I saw {list}.",
        "There I also saw {list}.",
        "Besides, {list} could be seen.",
        "There I noticed {list}, too.",
    ];
    LOOKED_IN_VAIN = [
        "I looked for {what}{at} and saw none.",
        "I searched for {what}{at} and found nothing.",
        "I looked for {what}{at}, but found none in view.",
        "I looked for {what}{at} without finding any.",
        "I searched the view for {what}{at} and found none.",
        "I checked the view for {what}{at}, but saw none.",
    ];
    WALKED = [
        "I walked around {place} and found {count}: {list}.",
        "I walked around {place} and saw {count}: {list}.",
        "Walking around {place}, I found {count}: {list}.",
        "I explored {place} and found {count}: {list}.",
        "I explored {place} and saw {count}: {list}.",
        "I went around {place} and noted {count}: {list}.",
    ];
    WALKED_IN_VAIN = [
        "I walked around {place} and found no objects.",
        "I walked around {place} and saw nothing on it.",
        "I explored {place} and found nothing.",
        "Walking around {place}, I found no objects.",
        "I explored {place} and saw no objects.",
        "I went around {place}, but there was nothing to be seen.",
    ];
    MARKED_PLACES = [
        "I marked the receptacles in view: {list}.",
        "I highlighted the receptacles in view: {list}.",
        "I had the receptacles in view numbered: {list}.",
        "I numbered the receptacles that I could see: {list}.",
        "I let the receptacles in view be marked: {list}.",
        "I checked which receptacles were in view: {list}.",
    ];
    GAZED = [
        "I gazed at {it}.",
        "I looked closely at {it}.",
        "I moved closer to {it} and looked at it.",
        "I approached {it} to look at it.",
        "I gazed at {it} from nearby.",
        "I went close to {it} for a better look.",
    ];
    PICKED = [
        "I picked up {it}{from}.",
        "I took {it}{from}.",
        "I grasped {it}{from}.",
        "I grabbed {it}{from}.",
        "I picked up {it}{from} and held it.",
        "I lifted {it}{from} with my gripper.",
    ];
    PLACED = [
        "I placed {it} on {place}.",
        "I put {it} on {place}.",
        "I set {it} down on {place}.",
        "I put down {it} on {place}.",
        "I deposited {it} on {place}.",
        "I laid {it} on {place}.",
    ];
    OPENED = [
        "I opened the door of {place}.",
        "I opened {place}.",
        "I pulled open the door of {place}.",
        "I opened {place}'s door.",
        "I swung open the door of {place}.",
        "I opened up {place}.",
    ];
    CLOSED = [
        "I closed the door of {place}.",
        "I closed {place}.",
        "I shut the door of {place}.",
        "I closed {place}'s door.",
        "I pushed the door of {place} shut.",
        "I closed the door of {place} again.",
    ];
    ASKED = [
        "I asked the user {question}, and the answer was {reply}.",
        "I asked the user {question} and was told {reply}.",
        "I asked the user {question}; the user said {reply}.",
        "I asked {question}, and the user answered {reply}.",
        "To my question {question} the user replied {reply}.",
        "I asked {question}. The user replied {reply}.",
    ];
    ASKED_IN_VAIN = [
        "I asked the user {question}, but got no answer.",
        "I asked the user {question} and nobody answered.",
        "I asked {question}, but no answer came.",
        "My question {question} was not answered.",
        "To my question {question} there was no answer.",
        "I asked {question} without getting an answer.",
    ];
    LISTED = [
        "I listed the receptacles of the home.",
        "I listed the receptacles of all rooms.",
        "I looked up the list of receptacles.",
        "I read the list of all receptacles.",
        "I asked for the list of receptacles and read it.",
        "I went through the list of receptacles.",
    ];
    CALLED = [
        "I called {tool}.",
        "I made a call of {tool}.",
        "I used {tool}.",
        "I called {tool} once.",
        "I ran {tool}.",
        "I tried out {tool}.",
    ];
    FAILED = [
        "I tried to {deed}, but {why}.",
        "I wanted to {deed}, but {why}.",
        "I tried to {deed}, which failed because {why}.",
        "I tried to {deed} without success: {why}.",
        "My attempt to {deed} failed: {why}.",
        "I could not {deed}, because {why}.",
    ];
}
