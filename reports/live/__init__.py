"""`termwise view`: every input of the decomposition on one local page, each term watched while it converges.

`state` is what is shown and how an input changes it, `live` renders it, `truth` judges it, `guard` keeps strangers out,
all without a toolkit; `page` alone knows NiceGUI. Of three toolkits the same page was tried, a number beside a picture
of 256 x 256 pixels (2 cores, other work beside it):

| | NiceGUI 3.18 | Panel 1.9 | trame 4.0 |
|---|---|---|---|
| number typed to picture changed | 53 ms | 130 ms | 36 ms |
| a second tab begins with | its own state | its own state | the first tab's state |
| a closed tab is noticed after | 1.1 s | 9.9 s | not within 40 s (`on_client_exited`) |
| loads from the network | nothing | nothing | nothing |
| a foreign Host, a foreign Origin | served, served | served, refused | served, served |
| its own packages, bokeh and vuetify counted | 29 MB | 151 MB | 24 MB |

Two tabs must not disturb each other and a closed one must stop its work: NiceGUI. Hosts and origins are checked by
`guard`, which any of the three would have needed.
"""
