"""The operator: who may order what (keys, signals, the remote control's switch), and the messages to a person.

May import: messages, the link's packets, safety's modes, the summary of recording.
"""
