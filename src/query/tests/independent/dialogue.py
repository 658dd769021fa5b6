"""Questions to the user and what comes of them."""
from collections import Counter

from .rows import ENDED, EPISODES, answers, distinct, group, mean, ordered, questions, share, success, wilson, won


@answers
def asks():
    rows = [question for episode in EPISODES for question in questions(episode)]
    return ordered(rows, "policy", "family", "task_id", "episode_id", "step")


@answers
def asking():
    rows = []
    for (policy, fuzzy), mine in sorted(group(ENDED, "policy", "fuzzy")):
        asked = [episode for episode in mine if any(questions(episode))]
        put = [question for episode in mine for question in questions(episode)]
        picked = [question for question in put if question["then_picked"]]
        rows.append({
            "policy": policy, "fuzzy": fuzzy, "episodes": len(mine), "asks": share(put, mine), "asked": share(asked, mine),
            "useful": share([q for q in put if q["useful"]], put),
            "answered": share([q for q in put if q["reply"] is not None], put),
            "picked_right": share([q for q in picked if q["then_picked"] == "right"], picked),
            "success_asked": success(asked), "success_unasked": success(e for e in mine if e not in asked),
        })
    return rows


@answers
def user_fidelity():
    played = {episode["episode_id"]: episode for episode in EPISODES}
    answered = [question for question in asks() if question["reply"] is not None]
    rows = []
    for (policy, source), mine in sorted(group(answered, "policy", "source")):
        episodes = [played[name] for name in {question["episode_id"] for question in mine}]
        ended = [episode for episode in episodes if episode["end_reason"] is not None]
        led = Counter(question["then_picked"] for question in mine)
        rows.append({
            "policy": policy, "source": source, "answers": len(mine), "words": mean(question["words"] for question in mine),
            "led_right": led["right"], "led_wrong": led["wrong"], "led_nowhere": led[None], "episodes": len(ended),
            "tasks": distinct(ended, "task_digest"), "won": len(won(ended)), "success": success(ended),
            **wilson(len(won(ended)), len(ended)),
        })
    return rows
