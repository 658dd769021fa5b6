//! Why the next call is made, in the first person and the present tense.

use crate::voice::wordings;

wordings! {
    // After a failure
    LAST_FAILED = [
        "My last call failed: {why}.",
        "That did not work, because {why}.",
        "The last attempt failed because {why}.",
        "I could not do that: {why}.",
        "That went wrong; {why}.",
        "The last call was refused: {why}.",
    ];
    FAILED_REPEATEDLY = [
        "The same call has failed {times} times now: {why}.",
        "This is failure number {times} of the same call; {why}.",
        "I have tried that {times} times in vain, because {why}.",
        "{times} attempts at the same thing have failed: {why}.",
        "That failed {times} times in a row, because {why}.",
        "Once more it did not work, after {times} tries in all: {why}.",
    ];
    ONCE_MORE = [
        "I try the same call once more.",
        "I give the same call another try.",
        "Perhaps it works when I try again, so I repeat the call.",
        "I repeat the call.",
        "I make the same attempt again.",
        "I do not see another way yet, so I try it again.",
    ];

    SAW_NOTHING = [
        "Nothing of the kind was found at {place}.",
        "I found nothing at {place}.",
        "There was nothing to be found at {place}.",
        "The search at {place} brought nothing.",
        "What I looked for is not to be seen at {place}.",
        "I had no luck at {place}.",
    ];

    // Going somewhere: what for
    FETCH = [
        "I have to get {object} from {phrase}.",
        "First I need {object}, which should be at {phrase}.",
        "The task says that {object} is at {phrase}.",
        "To start with I have to find {object} at {phrase}.",
        "What I need is {object}, and it should be at {phrase}.",
        "My hand is empty and I need {object} from {phrase}.",
    ];
    CARRY = [
        "I am holding {it}, which has to go to {phrase}.",
        "Now that I have {it}, I must bring it to {phrase}.",
        "{it} is in my hand, and the task wants it at {phrase}.",
        "With {it} in my hand, what is left is to take it to {phrase}.",
        "I have {it}; its destination is {phrase}.",
        "The next thing is to carry {it} to {phrase}.",
    ];
    DOOR_FIRST = [
        "In the end {object} must go to {phrase}, which may be shut, and I can open a door only while my hand is empty.",
        "The destination is {phrase}. If its door is closed I need a free hand to open it, so I do that before I get {object}.",
        "Before I get {object} I should see to the door of {phrase}, since I cannot open it with something in my hand.",
        "Once I carry {object} I can no longer open a door, so {phrase} comes first.",
        "I will have to put {object} behind the door of {phrase}, and opening it takes a free hand, so I start there.",
        "My hand is still free, so this is the time to open {phrase} for {object}.",
    ];
    RETURN_IT = [
        "I am holding {it}, which is not what was asked for, so it has to go back.",
        "{it} in my hand is not what is wanted, so I should return it.",
        "What I hold, {it}, is the wrong thing and must be put back.",
        "I took {it}, but that does not fit the task, so I bring it back.",
        "Since {it} is not what I was asked for, I cannot keep it in my hand.",
        "The wrong thing is in my hand: {it}. It has to be put down again.",
    ];
    SHUT_IT = [
        "{it} is in its place, but I left {place} open.",
        "{it} is placed; what is left is the door of {place}, which I opened myself.",
        "The door of {place} is still open because of me, and {it} is where it belongs.",
        "I have put {it} down; now the door of {place} should be closed again.",
        "With {it} delivered, I still have to shut {place}.",
        "I opened {place} and should not leave it open now that {it} is placed.",
    ];
    DELIVERED = [
        "{it} has been placed as the task says.",
        "I have already put {it} where it should go.",
        "The main thing is done: {it} is in its place.",
        "Nothing is left to carry, since {it} is placed.",
        "{it} is delivered.",
        "I have put {it} down at its destination.",
    ];

    // Going somewhere: why there
    ONLY_ONE = [
        "{place} is the only {kind} here, so I go there.",
        "There is just one {kind}, {place}, so that is where I go.",
        "The only {kind} in the list is {place}, so I head for it.",
        "Among the receptacles {place} is the one {kind}, so it must be that.",
        "That can only be {place}, since there is no other {kind}.",
        "As {place} is the one and only {kind}, I move there.",
    ];
    THE_ONE_IN_ROOM = [
        "{place} is the only {kind} in the {room}, so I go there.",
        "The {room} has just one {kind}, {place}, so that is where I go.",
        "By the list of receptacles the {kind} in the {room} is {place}, so I head for it.",
        "The list puts one {kind} in the {room}, {place}, so I move there.",
        "In the {room} there is one {kind}, and that is {place}. I go to it.",
        "The {kind} in the {room} can only be {place}, so I navigate to it.",
    ];
    ONE_OF_SEVERAL = [
        "There are {count} that it could be ({places}), and the names do not tell which one is meant, so I try {place}.",
        "It could be any of {places}, {count} in all; I go to {place} and see whether it looks right.",
        "{count} receptacles are of that kind: {places}. I have to look at them to know, so I go to {place}.",
        "The list alone does not decide between {places} ({count} in all). I take a look at {place}.",
        "The list has {count} of them, {places}. I cannot know which is meant before I see them, so I go to {place}.",
        "I see {count} possible receptacles in the list, {places}, and pick {place} to look at.",
    ];
    NEXT_OF_SEVERAL = [
        "{at} does not look like it, so I try {place} next.",
        "What I see at {at} does not seem to be the one described, so I go on to {place}.",
        "I doubt that {at} is the right one; {place} is also possible, so I check it.",
        "{at} does not fit the description well. The next one to check is {place}.",
        "Since {at} does not appear to be what was meant, I look at {place}.",
        "That description does not suit {at}, so I move on to {place}.",
    ];
    ALSO_POSSIBLE = [
        "{place} is of the same kind as {at}, so I look at it, too, before I decide.",
        "Before I settle on {at} I also want to see {place}.",
        "To be sure that I do not take {at} for another one, I also check {place}.",
        "{place} could be meant as well as {at}, so I compare.",
        "I am not certain about {at}; {place} may be the one, so I go and see.",
        "{at} is possible, but so is {place}, and I want to see both.",
    ];
    BACK_TO_IT = [
        "I have been at {place} before, and it is still the most likely one, so I go back.",
        "Of those that I have seen {place} seems the most likely, so I return to it.",
        "I already know {place}; what I need should be there, so I go there again.",
        "I return to {place}, which I have seen before.",
        "Having seen it before, I think {place} is the one, so I go back to it.",
        "I go to {place} again, since it still seems right to me.",
    ];
    STAY_CLOSE = [
        "I go to {place} again to get a better position.",
        "I am at {place} already, but a fresh viewpoint may help.",
        "I approach {place} anew, so that I stand well.",
        "A new approach to {place} should give me a better view.",
        "I take up position at {place} once again.",
        "To see {place} properly, I go to it again.",
    ];
    GUESS_PLACE = [
        "The instruction does not say that it is {place}; I only guess that {kind} is a likely place.",
        "I am guessing here: {kind} is a likely place, so I take a look at {place}.",
        "Nothing that I know points to {place}, but {kind} may be worth a look.",
        "It is only a guess, but {kind} could have something to do with it, so I check {place}.",
        "I do not know that {place} is right. {kind} is at least possible, so I go and see.",
        "I have no certain hint, so I try {place}; perhaps {kind} is where I have to be.",
    ];
    CAME_FROM = [
        "It came from {place}, so I go there.",
        "I took it from {place}, so that is where I bring it.",
        "{place} is where I got it, so I return there.",
        "As I found it at {place}, I go back to {place}.",
        "Its old place is {place}, so I head there.",
        "I go to {place}, because I took it from there.",
    ];
    HAVE_A_LOOK = [
        "I go and have a look at {place}.",
        "I go to {place} to see what it is like there.",
        "Next I see what {place} is like.",
        "I move to {place} for a look.",
        "I want to see {place}, so I go there.",
        "A look at {place} may help.",
    ];
    UNKNOWN_PLACE = [
        "I try to go to {place}.",
        "I see whether I can get to {place}.",
        "My guess is {place}, so I try to go there.",
        "Perhaps {place} is a place that I can go to.",
        "I attempt to reach {place}.",
        "I want to get to {place}, if there is such a place.",
    ];

    // Where I am
    HERE_IT_IS = [
        "I am at {place}, which looks like {phrase}.",
        "{place} looks like {phrase}, as the instruction puts it.",
        "I have reached {place}, and it fits the description: {phrase}.",
        "From what I see {place} is {phrase}.",
        "This seems right: {place} fits {phrase}.",
        "I stand at {place}, which I take for {phrase}.",
    ];
    HERE_MAYBE = [
        "I am at {place}, which could be {phrase}.",
        "I have reached {place}; it may or may not be {phrase}.",
        "I stand at {place}, and it is possible that this is {phrase}.",
        "{place} is of the right kind, though I am not sure that it is {phrase}.",
        "Perhaps {place} is {phrase}, as the instruction puts it.",
        "I am not certain that {place} is {phrase}, but I am here now.",
    ];
    HERE = [
        "I am at {place} now.",
        "I have reached {place}.",
        "I stand at {place}.",
        "I have arrived at {place}.",
        "My position is {place}.",
        "Now I am in front of {place}.",
    ];

    // Looking
    LOOK_AT_SEEN = [
        "I can see {thing}, which could be {object}, so I have {what} marked.",
        "There is {thing} in view; that may be {object}. I mark {what} to get its number.",
        "The view shows {thing}, perhaps {object}. To be able to point at it I search for {what}.",
        "{thing} is in front of me and might be {object}, so I let {what} be numbered.",
        "Since I see {thing}, a candidate for {object}, I search the view for {what}.",
        "To get a number for {thing}, which may be {object}, I look for {what}.",
    ];
    LOOK_FOR_IT = [
        "I need a number for {object}, so I check whether {what} is in view.",
        "I look whether {what} is in view, since that is what {object} would be.",
        "Before I pick anything I search the view for {what}, to find {object}.",
        "To find {object} I have {what} marked in the view.",
        "Next I see whether {what} can be found here, as I need {object}.",
        "{object} may be in view, so I search for {what}.",
    ];
    LOOK_FOR_KIND = [
        "{what} would count as {kind}, so I check whether there is one in view.",
        "{kind} is wanted, and {what} would be one, so I look for that.",
        "I was asked for {kind}; {what} is a good guess, so I search for it.",
        "One kind of what I need is {what}, since I was asked for {kind}. I check the view for it.",
        "As {kind} is asked for, I look whether {what} is here.",
        "What is wanted is {kind}. I search the view for {what}, which would fit.",
    ];
    LOOK_FOR_OTHER = [
        "I check whether {what} is in view.",
        "I want to know whether {what} is here.",
        "Perhaps {what} is around; I have a look.",
        "I search the view for {what}.",
        "I see whether I can find {what} from here.",
        "It may help to know whether {what} is in view.",
    ];
    WALK_TO_FIND = [
        "There is no sign of {what} from where I stand, so I walk around {place} to see all of it.",
        "From this side I do not see {what}; walking around {place} shows what is on it.",
        "I cannot find {what} in this view. Perhaps it is hidden, so I walk around {place}.",
        "The view did not show {what}, so I take stock of {place} on foot.",
        "Something may hide {what} from me here, so I go around {place}.",
        "I did not see {what}, but I have not seen all of {place} either, so I walk around it.",
    ];
    WALK_TO_COMPARE = [
        "Before I decide on {object} I want to know everything that is on {place}, so I walk around it.",
        "There may be more things on {place} that could be {object}, so I walk around it first.",
        "One view is not enough to be sure about {object}; I take stock of {place}.",
        "To compare all that could be {object} I walk around {place}.",
        "I should not take the first thing for {object}, so I see what else is on {place}.",
        "I walk around {place} to see whether anything else could be {object}.",
    ];
    WALK_AROUND = [
        "I walk around {place} to see what is on it.",
        "I take stock of what is on {place}.",
        "I want to know what is on {place}, so I walk around it.",
        "A walk around {place} tells me which objects are there.",
        "I do not know yet what is on {place}, so I go around it.",
        "To see {place} from all sides I walk around it.",
    ];
    MARK_TO_PLACE = [
        "To put {it} down I need the number of {phrase}, so I mark the receptacles in view.",
        "I cannot place {it} without a marker for {phrase}, so I have the receptacles numbered.",
        "Placing {it} takes the marker of {phrase}; I highlight the receptacles to get it.",
        "I need to know which marker is {phrase} before I can put {it} there.",
        "{it} shall go to {phrase}. For that I need its number, so I mark what is in view.",
        "Next I have the receptacles marked, so that I can point at {phrase} and place {it}.",
    ];
    MARK_TO_OPEN = [
        "To open {place} I need its number, so I mark the receptacles in view.",
        "I want to open {place} while my hand is free, and for that I need its marker.",
        "Opening {place} takes a marker, so I have the receptacles numbered.",
        "The door of {place} comes first; I mark the receptacles to be able to point at it.",
        "I need a marker for {place} before I can open its door.",
        "I highlight the receptacles in view, so that I can open {place}.",
    ];
    MARK_TO_CLOSE = [
        "To close {place} I need its number, so I mark the receptacles in view.",
        "{place} is still open, and I need its marker to shut it.",
        "Closing {place} takes a marker, so I have the receptacles numbered.",
        "I need a marker for {place} before I can close its door.",
        "The door of {place} should be shut; I mark the receptacles to point at it.",
        "I highlight the receptacles in view, so that I can close {place}.",
    ];
    MARK_TO_SEE = [
        "I mark the receptacles in view to see which ones are around me.",
        "To know where I am I have the receptacles in view numbered.",
        "I want to know which receptacles I can see from here.",
        "Which receptacles are in view will tell me more, so I mark them.",
        "I highlight the receptacles in view to get my bearings.",
        "It helps to know what furniture is in view, so I let it be marked.",
    ];

    // Looking closely and picking
    GAZE_FITS = [
        "Marker {marker} is {looks}, which fits {object}. I look at it closely before I touch it.",
        "{looks} with marker {marker} fits {object}, so I approach it.",
        "I take marker {marker} for {object}: it is {looks}. I move closer.",
        "I need {object}, and marker {marker} is {looks}. I go close to it.",
        "By its looks ({looks}) marker {marker} is {object}, so I take a closer look.",
        "Marker {marker} shows {looks}; that goes with {object}. I get within reach of it.",
    ];
    GAZE_AMONG = [
        "Of the marked things marker {marker} is {looks}, which fits {object}; {others}. I look closely at marker {marker}.",
        "I compare: marker {marker} is {looks}, while {others}. The first fits {object}, so I approach it.",
        "The one that fits {object} is marker {marker}, {looks}; {others}. I go closer to it.",
        "Looking for {object}, I choose marker {marker}: it is {looks}. As to the rest, {others}.",
        "Marker {marker} is {looks} and {others}. Only marker {marker} goes with {object}, so I take a closer look at it.",
        "By its looks marker {marker} ({looks}) is {object}; {others}. I approach marker {marker}.",
    ];
    GAZE_ANSWERED = [
        "The user said {reply}. Marker {marker} is {looks} and fits that, so I go close to it.",
        "After the answer {reply} it is clear: marker {marker}, {looks}. I approach it.",
        "The answer was {reply}, which fits marker {marker}, {looks}. I take a closer look at it.",
        "I was told {reply}. That is marker {marker}, {looks}, so I move closer to it.",
        "{reply} was the answer, and marker {marker} is {looks}. I look at it closely.",
        "With the answer {reply} I know that I need marker {marker}: it is {looks}. I get close to it.",
    ];
    GAZE_UNSURE = [
        "Marker {marker} is {looks}. I doubt that it is {object}, but a closer look will tell.",
        "I am not sure about marker {marker}, {looks}, so I look at it closely; I need {object}.",
        "Marker {marker} shows {looks}. To see whether it could be {object}, I move closer.",
        "It is not clear to me whether marker {marker} ({looks}) is {object}, so I approach it.",
        "I want to see marker {marker} from nearby: {looks}. Perhaps it is {object}.",
        "Perhaps marker {marker}, {looks}, is {object}; I check it up close.",
    ];
    GAZE_PLACE = [
        "Marker {marker} is {place}, and I want to stand right in front of it.",
        "I approach {place}, which has marker {marker}.",
        "To see {place} better I look at marker {marker}.",
        "I move closer to marker {marker}, that is {place}.",
        "{place} is marker {marker}; I take a closer look at it.",
        "I want a close view of {place}, so I gaze at marker {marker}.",
    ];
    GAZE_BLIND = [
        "I want to look closely at marker {marker}.",
        "I try to approach marker {marker}.",
        "I see whether marker {marker} can be looked at from nearby.",
        "I believe that marker {marker} is worth a closer look.",
        "I try to get close to marker {marker}.",
        "My next idea is to look at marker {marker}.",
    ];
    PICK_READY = [
        "I am close to marker {marker}, {looks}; it is {object} and my hand is free, so I pick it up.",
        "From nearby marker {marker} still looks right for {object}: it is {looks}. I take it.",
        "Up close I am convinced that marker {marker}, {looks}, is {object}. I pick it up.",
        "Marker {marker} is within reach and is {looks}. That is {object}, so I grasp it.",
        "The close view confirms that marker {marker} is {looks}. I pick up {object}.",
        "Nothing speaks against marker {marker}, {looks}, being {object}, and it is near enough to be picked up.",
    ];
    PICK_NOW = [
        "Marker {marker} is {looks}, which fits {object}. My hand is free, so I pick it up.",
        "I take marker {marker} for {object}, as it is {looks}, and try to pick it up.",
        "{looks} with marker {marker} fits {object}, so I pick it up right away.",
        "By its looks ({looks}) marker {marker} is {object}, so I grasp it.",
        "Marker {marker} shows {looks}; that is {object}, I think. I pick it up.",
        "I need {object}, and marker {marker} is {looks}. I take it.",
    ];
    PICK_UNSURE = [
        "Marker {marker} is {looks}. I am not sure that it is {object}, but I take it as my best guess.",
        "I am in doubt whether marker {marker}, {looks}, is {object}; I pick it up all the same.",
        "My guess is marker {marker}, {looks}, although it may not be {object}.",
        "I go for marker {marker}, which is {looks}, and hope that it will do for {object}.",
        "It is a guess that marker {marker} ({looks}) is {object}; I pick it up.",
        "Marker {marker}, {looks}, may not be {object}, but it is what I try now.",
    ];
    PICK_BLIND = [
        "I try to pick up marker {marker}.",
        "I reach for marker {marker}.",
        "I see whether marker {marker} can be picked up.",
        "My next attempt is to pick up marker {marker}.",
        "I believe that marker {marker} is what I need, so I try to take it.",
        "I try to grasp what I remember as marker {marker}.",
    ];

    // Placing and doors
    PLACE_HERE = [
        "Marker {marker} is {place}, which I take for {phrase}, so I put {it} there.",
        "{place} has marker {marker} and should be {phrase}. I place {it} on it.",
        "I hold {it}, and {phrase} is marker {marker} ({place}). I put it down there.",
        "The destination, {phrase}, is {place} with marker {marker}, so {it} goes there.",
        "Marker {marker} stands for {place}. That is where {it} belongs, as {phrase} is the destination.",
        "By the map {place} is marker {marker}. I take it for {phrase} and place {it} there.",
    ];
    PLACE_BACK = [
        "{it} is not what was asked for, so I put it down on {place}, marker {marker}.",
        "I return {it} to {place}, which is marker {marker}, since it is the wrong thing.",
        "Marker {marker} is {place}; I leave {it} there, because it is not what I need.",
        "I need my hand for the right thing, so {it} goes to {place}, marker {marker}.",
        "To get rid of {it}, which does not fit the task, I place it on {place} (marker {marker}).",
        "As {it} is wrong, I put it on {place} with marker {marker}.",
    ];
    PLACE_GUESS = [
        "I put {it} on {place}, marker {marker}, though the instruction does not name it clearly.",
        "Marker {marker} is {place}. I am not sure about it, but I place {it} there.",
        "My best guess for {it} is {place} with marker {marker}.",
        "I place {it} on {place} (marker {marker}), as far as I can tell a possible place.",
        "Perhaps {place}, marker {marker}, will do for {it}, so I put it there.",
        "I try {place}, which is marker {marker}, for {it}.",
    ];
    PLACE_BLIND = [
        "I try to place {it} on marker {marker}.",
        "I want to put {it} on marker {marker}.",
        "I see whether {it} can go on marker {marker}.",
        "My next attempt is to put {it} down at marker {marker}.",
        "I remember marker {marker} as a place for {it} and try it.",
        "I go on as if {it} could be put on marker {marker}.",
    ];
    OPEN_FOR_IT = [
        "Marker {marker} is {place}. My hand is free, so I open its door for {object} now.",
        "{place} has marker {marker}; it must be open before I come back with {object}, so I open it.",
        "I open {place} (marker {marker}) now, because I will not be able to with {object} in my hand.",
        "The door of {place}, marker {marker}, has to be open for {object}, and my hand is empty now.",
        "To have {place} ready for {object} I open marker {marker}.",
        "With a free hand I can open {place}, marker {marker}, so that {object} can go in later.",
    ];
    OPEN_TO_SEE = [
        "Marker {marker} is {place}. I open it to see what is inside, as {object} may be there.",
        "{object} may be behind the door of {place}, so I open marker {marker}.",
        "As long as {place} is shut I cannot see inside, so I open marker {marker} and look for {object}.",
        "I open {place}, marker {marker}, to find out whether {object} is in there.",
        "To look for {object} in {place} I open its door, marker {marker}.",
        "The door of {place} (marker {marker}) hides what is inside; I open it on the way to {object}.",
    ];
    OPEN_BLIND = [
        "I try to open marker {marker}.",
        "I see whether marker {marker} can be opened.",
        "I want the door of marker {marker} open.",
        "My next attempt is to open marker {marker}.",
        "I think that marker {marker} has a door, so I try to open it.",
        "I go for the door of marker {marker}.",
    ];
    CLOSE_IT = [
        "I no longer need {place} open, so I close marker {marker}.",
        "{place} is marker {marker}; I am done there, so I shut its door.",
        "The door of {place} should not stay open, so I close marker {marker}.",
        "I leave {place} as I found it and close its door, marker {marker}.",
        "I am done with {place}, marker {marker}, so its door can be closed.",
        "To finish tidily I close the door of {place} (marker {marker}).",
    ];
    CLOSE_BLIND = [
        "I try to close marker {marker}.",
        "I see whether marker {marker} can be closed.",
        "I want the door of marker {marker} shut.",
        "My next attempt is to close marker {marker}.",
        "I think that the door of marker {marker} should be shut.",
        "I go to shut marker {marker}.",
    ];

    // Asking
    ASK_AMONG = [
        "The instruction only speaks of {object}, and I have seen {count} that fit: {list}. I ask which one is meant.",
        "{list} could all be {object}, {count} in all. Guessing would be wrong here, so I ask the user.",
        "I cannot tell which is {object}: {list} all fit, and that makes {count}. The user has to say which.",
        "By the instruction {object} may be any of these {count}: {list}. I had better ask.",
        "There are {count} candidates for {object}, namely {list}. Only the user knows which is meant, so I ask.",
        "Since {count} things that I saw fit {object} ({list}), I ask before I pick one.",
    ];
    ASK_UNCLEAR = [
        "The instruction says no more than {object}, so I ask what exactly is meant.",
        "I am not sure what is meant by {object}, and the user can tell me.",
        "Before I go on I want to know more about {object}, so I ask.",
        "What I know about {object} is not enough to go on, so I ask the user.",
        "A question to the user may tell me more about {object}.",
        "I would rather ask than guess about {object}.",
    ];
    ASK_WHERE = [
        "I am not sure which place is meant by {phrase}, so I ask the user.",
        "Several places could be {phrase}; the user can tell me which.",
        "Before I choose a place I want to be sure about {phrase}, so I ask.",
        "I would rather ask than guess what {phrase} is.",
        "Where exactly {phrase} is, the user knows better than I do, so I ask.",
        "A question to the user may tell me which place {phrase} is.",
    ];

    // The end, and what is no tool
    FINISH_DONE = [
        "{it} is on {place} now, as the task says, and nothing is left to do, so I finish.",
        "I have put {it} on {place}, which is what was asked for. I finish.",
        "With {it} on {place} the task is done, so I end the episode.",
        "The task was to bring {it} to its place, and it is on {place} now. I am done.",
        "Everything is done: {it} lies on {place}. I finish here.",
        "As {it} is on {place} now, there is nothing more to do, and I finish.",
    ];
    FINISH_HOLDING = [
        "I still hold {it}, but I do not see how to go on, so I finish.",
        "I give up with {it} in my hand and end the episode.",
        "I am holding {it} and know no further step, so I finish.",
        "Though {it} is in my hand, I end the episode here.",
        "I see no way to deliver {it}, so I finish.",
        "I stop here, with {it} still in my hand.",
    ];
    FINISH_STUCK = [
        "I do not know what else I could do about {object}, so I finish.",
        "I give up on {object} and end the episode.",
        "I see no further way to deal with {object}, so I finish.",
        "I end the episode here, as I know no next step for {object}.",
        "There is nothing more that I would try for {object}, so I finish.",
        "I stop here, although I cannot say that {object} is where it should be.",
    ];
    LIST_PLACES = [
        "I want to see the list of receptacles.",
        "The list of rooms and receptacles may help me to plan.",
        "To plan my way I look at the list of receptacles.",
        "I look up which receptacles there are.",
        "I check the list of receptacles before I go on.",
        "I need to know which receptacles the home has, so I list them.",
    ];
    CALL_OTHER = [
        "I try {tool}.",
        "I see what {tool} does.",
        "I think that {tool} may help here.",
        "My next call is {tool}.",
        "I attempt to call {tool}.",
        "I give {tool} a try.",
    ];
}
