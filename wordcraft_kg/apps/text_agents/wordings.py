"""Ten wordings of the rules, so that a language model learns the game and not its prompt.

The benchmark's prompt is the first one. The others say the same in other words, from a template
with two slots: the items of an attempt, and the form of an answer.
"""

from wordcraft_kg.apps.text_agents.conversation import Conversation

_PICKS = {
    False: "two items, or one item twice",
    True: "between one and {most} items, repeats included",
}
"""Items of an attempt, for pairs and for sets."""
_FORM = {False: "water + earth", True: "water + earth + fire"}
"""Example of an answer, for pairs and for sets."""
WORDINGS = (
    (
        "Here is a puzzle about crafting. Pick {picks} in every attempt. Items are never consumed, "
        "and a new item joins the table. Most picks lead nowhere. Reach the goal in time; the "
        "table always allows it.",
        "End your answer with a line such as: {form}. Use listed items only.",
    ),
    (
        "You stand at a crafting table. An attempt joins {picks}. Few combinations work. Items "
        "stay after use, and results can be used again. Your task is the goal item, which this "
        "table can produce.",
        "Write the items of the attempt with plus signs in the last line, as in {form}.",
    ),
    (
        "Craft the goal. To try something, combine {picks}. Items that you make are added to the "
        "list, nothing is used up, and a wrong combination makes nothing. There is always a way.",
        "Reply with the names or numbers of listed items, joined by plus signs: {form}",
    ),
    (
        "Game: make a wanted item out of those on a table. One attempt = {picks}. A combination "
        "without a recipe costs the attempt and makes nothing. Ingredients remain available.",
        "Format of the last line: {form} (items from the table only).",
    ),
    (
        "The table below holds some items. Among them are all that the goal needs. In an attempt "
        "you put together {picks}; if a recipe exists, its result comes to the table. Your items "
        "do not run out, but your attempts do.",
        "Give your choice in the last line like this: {form}.",
    ),
    (
        "Which items make the goal? You may test {picks} at a time, as long as attempts are left. "
        "Results are kept, used items too. Expect most tests to yield nothing.",
        "Answer in the form {form}, with items that are on the table.",
    ),
    (
        "Think of an alchemist who joins things to get new things. Each attempt takes {picks}. "
        "Nothing that you own is lost. Create the goal item before the attempts are over. It is "
        "possible with this table.",
        "State the items to join, for example {form}, as the last line.",
    ),
    (
        "Rules: (1) an attempt combines {picks}; (2) what you make can be used afterwards; "
        "(3) ingredients are not consumed; (4) most attempts make nothing; (5) the goal can be "
        "made from the table.",
        "Output: one line with listed items and plus signs, such as {form}.",
    ),
    (
        "I give you a goal and a table with items. Tell me what to combine: {picks} for each "
        "attempt. I add whatever comes out to the table and tell you how many attempts are left. "
        "Items can be used any number of times.",
        "Say it as {form} in your last line, and name only items that I list.",
    ),
)
"""Rules and form of an answer, beside the wording of the benchmark."""


def worded_rules(talk: Conversation, wording: int, *, by_tool: bool) -> str:
    """Return the rules of a game in a wording.

    Args:
        talk: the conversation, without look-ups.
        wording: 0 for the benchmark's wording, else a number up to the size of ``WORDINGS``.
        by_tool: whether the tool's schema says how to answer, and the rules need not.
    """
    game = talk.game
    call = "Use the tool `combine` for each attempt."
    if not wording:
        return f"{game.rules}\n{call}" if by_tool else talk.rules
    rules, form = WORDINGS[wording - 1]
    is_set = game.most_picks > 0
    text = rules.format(picks=_PICKS[is_set].format(most=game.most_picks))
    return f"{text}\n{call if by_tool else form.format(form=_FORM[is_set])}"
